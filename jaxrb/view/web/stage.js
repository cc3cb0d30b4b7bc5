// Renderer, lights, and the half-spaces on which bodies stand. World axes as in jaxrb: z is up, lengths in metres.
import * as THREE from "three";

// Points a point of the screen, where drawing is slow: first all, without shadows.
const COARSER = [1, 0.75, 0.5];

export class Stage {
  constructor(canvas, frame) {
    this.canvas = canvas;
    this.frame = frame; // what must be seen: centre and radius [m]
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "low-power" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(32, 1, frame.radius / 200, frame.radius * 400);
    this.camera.up.set(0, 0, 1);
    this.fading = []; // materials of grids, whose colour follows the theme
    this.shades = []; // and of grounds that show shadows
    this.#light();
    this.#axes();
    this.slow = this.frames = 0;
    this.coarser = 1;
    this.spent = [];
    this.outlines = {}; // the material of the bodies' edges
  }

  #light() {
    const { center, radius } = this.frame;
    this.sky = new THREE.HemisphereLight(0xffffff, 0xb9b4aa);
    this.sky.position.set(0, 0, 1);
    const sun = new THREE.DirectionalLight(0xffffff);
    sun.position.set(-1.1, -1.6, 2.6).normalize().multiplyScalar(4 * radius).add(center);
    sun.target.position.copy(center);
    sun.castShadow = true;
    sun.shadow.mapSize.set(2048, 2048);
    sun.shadow.radius = 3;
    sun.shadow.bias = -2e-4;
    sun.shadow.normalBias = 0.004 * radius;
    Object.assign(sun.shadow.camera, {
      left: -1.5 * radius, right: 1.5 * radius, top: 1.5 * radius, bottom: -1.5 * radius,
      near: radius, far: 9 * radius,
    });
    this.sun = sun;
    this.scene.add(this.sky, sun, sun.target);
  }

  // The world's axes, in a corner of the picture: a scene and a camera of their own.
  #axes() {
    this.corner = new THREE.Scene();
    this.cornerCamera = new THREE.OrthographicCamera(-1.4, 1.4, 1.4, -1.4, -3, 3);
    const named = [["x", 0xc0504a, [1, 0, 0]], ["y", 0x4f8f4f, [0, 1, 0]], ["z", 0x4a76b8, [0, 0, 1]]];
    for (const [, colour, direction] of named) {
      const arrow = new THREE.ArrowHelper(new THREE.Vector3(...direction), new THREE.Vector3(), 1, colour, 0.3, 0.18);
      this.corner.add(arrow);
    }
    this.axisNames = named.map(([name, colour, direction]) => ({ name, colour, at: new THREE.Vector3(...direction) }));
  }

  // A half-space as a plane with a grid; walls are only hinted at, since they would hide what they hold.
  addPlane([x, y, z, offset]) {
    const { center, radius } = this.frame;
    const normal = new THREE.Vector3(x, y, z);
    const group = new THREE.Group();
    const foot = center.clone().addScaledVector(normal, offset - normal.dot(center));
    group.position.copy(foot);
    group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), normal);
    const floor = normal.z > 0.5;
    const reach = floor ? 8 * radius : 1.6 * radius;
    const ground = new THREE.Mesh(
      new THREE.PlaneGeometry(2 * reach, 2 * reach),
      floor
        ? new THREE.ShadowMaterial({ depthWrite: false })
        : new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.05, side: THREE.DoubleSide, depthWrite: false }),
    );
    ground.receiveShadow = floor;
    ground.renderOrder = -1;
    group.add(ground);
    if (floor) this.shades.push(ground.material);
    else this.fading.push(ground.material);
    if (floor) group.add(this.#grid(reach, radius, foot, normal));
    this.scene.add(group);
  }

  // Lines a round number of metres apart, through the world's origin where the plane is level, fading outwards.
  #grid(reach, radius, foot, normal) {
    const step = roundStep(radius / 2.5);
    this.gridStep = step;
    const level = normal.z > 0.9999;
    const shift = level ? [-(foot.x % step), -(foot.y % step)] : [0, 0];
    const lines = Math.floor(reach / step / 2);
    const points = [];
    const pieces = 24; // so that a line can fade along its length
    for (let i = -lines; i <= lines; i += 1) {
      for (let j = 0; j < pieces; j += 1) {
        const [a, b] = [j, j + 1].map((k) => (2 * k / pieces - 1) * lines * step);
        points.push(i * step + shift[0], a + shift[1], 0, i * step + shift[0], b + shift[1], 0);
        points.push(a + shift[0], i * step + shift[1], 0, b + shift[0], i * step + shift[1], 0);
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
    const fade = [];
    for (let k = 0; k < points.length; k += 3) {
      const away = Math.hypot(points[k], points[k + 1]) / (lines * step);
      fade.push(1, 1, 1, Math.max(0, 1 - away) ** 1.5);
    }
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(fade, 4));
    const material = new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false });
    this.fading.push(material);
    const grid = new THREE.LineSegments(geometry, material);
    grid.renderOrder = -1;
    return grid;
  }

  paint(theme) {
    this.scene.background = new THREE.Color(theme.background);
    this.fading.forEach((material) => material.color.set(theme.line));
    this.shades.forEach((material) => { material.opacity = theme.dark ? 0.5 : 0.24; });
    this.sky.intensity = theme.dark ? 2.2 : 2.7;
    this.sun.intensity = theme.dark ? 2.2 : 2.3;
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2) * this.coarser);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  render() {
    const { renderer, camera } = this;
    const size = renderer.getSize(new THREE.Vector2());
    renderer.setViewport(0, 0, size.x, size.y);
    renderer.render(this.scene, camera);
    const edge = 76;
    this.cornerCamera.quaternion.copy(camera.quaternion);
    renderer.autoClear = false;
    renderer.setViewport(size.x - edge - 10, 10, edge, edge);
    renderer.clearDepth();
    renderer.render(this.corner, this.cornerCamera);
    renderer.autoClear = true;
    this.frames += 1;
  }

  // Told the time between two pictures of a run that plays. Where pictures come too slowly (drawing without a graphics
  // card) they do without shadows, then get coarser. Their own time would not tell: drawing goes on after the call.
  noteInterval(milliseconds) {
    this.spent.push(milliseconds);
    if (this.spent.length < 10) return;
    const middle = this.spent.sort((a, b) => a - b)[5];
    this.spent = [];
    if (middle < 30 || this.slow >= COARSER.length) return;
    this.sun.castShadow = false;
    this.shades.forEach((material) => { material.visible = false; });
    if (this.slow > 0) this.outlines.visible = false;
    this.coarser = COARSER[this.slow];
    this.slow += 1;
    this.fit();
  }
}

// 1, 2 or 5 times a power of ten, at most `length`.
export function roundStep(length) {
  const ten = 10 ** Math.floor(Math.log10(length));
  return ten * ([5, 2].find((k) => k * ten <= length) ?? 1);
}
