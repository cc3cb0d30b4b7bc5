"""Floor 7: reading and writing."""

from jaxrb.io.mesh import read_mesh as read_mesh
from jaxrb.io.recording import Recording as Recording
from jaxrb.io.recording_files import read_recording as read_recording
from jaxrb.io.recording_files import write_recording as write_recording
from jaxrb.io.replay import replay as replay
from jaxrb.io.run import run as run
