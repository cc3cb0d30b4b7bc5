"""Floor 2: shapes, no dynamics."""

from jaxrb.geometry.bounds import bounding_box as bounding_box
from jaxrb.geometry.bounds import bounding_sphere as bounding_sphere
from jaxrb.geometry.bounds import oriented_box as oriented_box
from jaxrb.geometry.decomposition import convex_decomposition as convex_decomposition
from jaxrb.geometry.hull import ConvexHull as ConvexHull
from jaxrb.geometry.hull import stack_hulls as stack_hulls
from jaxrb.geometry.mesh import TriangleMesh as TriangleMesh
from jaxrb.geometry.primitives import Box as Box
from jaxrb.geometry.primitives import Capsule as Capsule
from jaxrb.geometry.primitives import Composite as Composite
from jaxrb.geometry.primitives import Cone as Cone
from jaxrb.geometry.primitives import Cylinder as Cylinder
from jaxrb.geometry.primitives import Ellipsoid as Ellipsoid
from jaxrb.geometry.primitives import HalfSpace as HalfSpace
from jaxrb.geometry.primitives import Pose as Pose
from jaxrb.geometry.primitives import Sphere as Sphere
from jaxrb.geometry.shape import Shape as Shape
