// A camera that circles a target: drag turns, right drag or two fingers shift, wheel or pinch come nearer.
import * as THREE from "three";

const STEEPEST = 0.5 * Math.PI - 0.02;

export class Orbit {
  constructor(camera, canvas, frame, changed) {
    Object.assign(this, { camera, canvas, frame, changed });
    this.target = new THREE.Vector3();
    this.pointers = new Map();
    this.reset();
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.nearer(Math.exp(0.0012 * Math.max(-200, Math.min(200, event.deltaY))));
    }, { passive: false });
  }

  // All of the run in the picture, seen across its longer side.
  reset() {
    const { center, radius, across } = this.frame;
    this.target.copy(center);
    this.azimuth = (across === 0 ? -0.5 : 0) * Math.PI + 0.42;
    this.height = 0.3;
    this.distance = this.#fitting();
    this.place();
  }

  // The least distance from which the corners of the box about the motion are all in the picture, and a little more.
  #fitting() {
    const { half } = this.frame;
    const back = new THREE.Vector3(
      Math.cos(this.height) * Math.cos(this.azimuth), Math.cos(this.height) * Math.sin(this.azimuth), Math.sin(this.height),
    );
    const right = new THREE.Vector3(0, 0, 1).cross(back).normalize();
    const up = back.clone().cross(right);
    const tall = Math.tan(THREE.MathUtils.degToRad(0.5 * this.camera.fov));
    const wide = tall * (this.camera.aspect || 1);
    let distance = 0;
    for (let k = 0; k < 8; k += 1) {
      const corner = new THREE.Vector3(...[half.x, half.y, half.z].map((h, axis) => ((k >> axis) & 1 ? h : -h)));
      const needed = Math.max(Math.abs(corner.dot(right)) / wide, Math.abs(corner.dot(up)) / tall);
      distance = Math.max(distance, needed + corner.dot(back));
    }
    return 1.15 * distance;
  }

  place() {
    const flat = Math.cos(this.height) * this.distance;
    this.camera.position.set(
      this.target.x + flat * Math.cos(this.azimuth),
      this.target.y + flat * Math.sin(this.azimuth),
      this.target.z + Math.sin(this.height) * this.distance,
    );
    this.camera.near = this.distance / 200;
    this.camera.far = this.distance * 20 + 40 * this.frame.radius;
    this.camera.updateProjectionMatrix();
    this.camera.lookAt(this.target);
    this.camera.updateMatrixWorld();
    this.changed();
  }

  turn(right, up) {
    this.azimuth -= right;
    this.height = Math.max(-STEEPEST, Math.min(STEEPEST, this.height + up));
    this.place();
  }

  nearer(factor) {
    const { radius } = this.frame;
    this.distance = Math.max(0.02 * radius, Math.min(60 * radius, this.distance * factor));
    this.place();
  }

  shift(right, up) {
    const scale = (2 * Math.tan(THREE.MathUtils.degToRad(0.5 * this.camera.fov)) * this.distance) / this.canvas.clientHeight;
    const step = new THREE.Vector3(-right * scale, up * scale, 0).applyQuaternion(this.camera.quaternion);
    this.target.add(step);
    this.place();
  }

  // Keeps a body where it is in the picture.
  follow(x, y, z) {
    if (this.target.x === x && this.target.y === y && this.target.z === z) return;
    this.target.set(x, y, z);
    this.place();
  }

  #down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.moved = 0;
  }

  #move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    this.moved += Math.hypot(dx, dy);
    if (this.pointers.size === 1) {
      const shifts = event.buttons === 2 || event.shiftKey;
      if (shifts) this.shift(dx, dy);
      else this.turn(0.006 * dx, 0.006 * dy);
    } else {
      const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
      const apart = ([x, y]) => Math.max(1, Math.hypot(x - other[0], y - other[1]));
      this.nearer(apart(before) / apart(now));
      this.shift(0.5 * dx, 0.5 * dy);
    }
    this.pointers.set(event.pointerId, now);
  }
}
