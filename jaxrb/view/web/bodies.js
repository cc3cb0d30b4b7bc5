// Bodies and what stands still, as groups of meshes. The group of a body has exactly the body's pose.
import * as THREE from "three";
import { arrayOf } from "jaxrb/motion";

// Muted, told apart also by those who confuse red and green (after Okabe and Ito 2008, softened).
export const COLOURS = ["#5b8db8", "#dd9a57", "#6fa58a", "#b9799b", "#d7bd5c", "#7f86c4", "#c47a63", "#84a9b8"];
const MOST_WITH_EDGES = 120; // bodies; more outlines than that cost more than they show

export class Bodies {
  constructor(header, buffer, motion) {
    this.motion = motion;
    this.surfaces = header.surfaces.map((surface) => geometryOf(surface, buffer));
    this.edges = new Map();
    this.outlined = header.bodies.length <= MOST_WITH_EDGES;
    this.line = new THREE.LineBasicMaterial({ color: 0x000000, transparent: true, opacity: 0.28 });
    this.chosen = -1;
    this.groups = header.bodies.map((body, i) => {
      const material = new THREE.MeshLambertMaterial({ color: COLOURS[i % COLOURS.length] });
      const group = this.#group(body.parts, material);
      group.userData.body = i;
      return group;
    });
    const still = new THREE.MeshLambertMaterial({ color: 0x9a9a96 });
    this.still = header.obstacles.filter((o) => !o.plane).map((o) => this.#group(o.parts, still));
    this.place = [0, 0, 0];
    this.turn = [1, 0, 0, 0];
  }

  #group(parts, material) {
    const group = new THREE.Group();
    for (const part of parts) {
      const mesh = new THREE.Mesh(this.surfaces[part.surface], material);
      mesh.scale.fromArray(part.scale);
      mesh.position.fromArray(part.position);
      const [w, x, y, z] = part.orientation;
      mesh.quaternion.set(x, y, z, w);
      mesh.castShadow = true;
      mesh.receiveShadow = true;
      if (this.outlined) mesh.add(new THREE.LineSegments(this.#edgesOf(part.surface), this.line));
      group.add(mesh);
    }
    return group;
  }

  #edgesOf(number) {
    if (!this.edges.has(number)) this.edges.set(number, new THREE.EdgesGeometry(this.surfaces[number], 35));
    return this.edges.get(number);
  }

  // Puts every body where it is at a time.
  show(time) {
    const at = this.motion.at(time);
    this.groups.forEach((group, i) => {
      const [x, y, z] = this.motion.placeOf(i, at, this.place);
      const [w, a, b, c] = this.motion.turnOf(i, at, this.turn);
      group.visible = Number.isFinite(x + y + z + w + a + b + c);
      if (!group.visible) return;
      group.position.set(x, y, z);
      group.quaternion.set(a, b, c, w);
    });
    return at;
  }

  // Where body i is drawn.
  pose(i) {
    const group = this.groups[i];
    if (!group) throw new RangeError(`there is no body ${i}; there are ${this.groups.length}`);
    const q = group.quaternion;
    return { position: group.position.toArray(), orientation: [q.w, q.x, q.y, q.z], visible: group.visible };
  }

  choose(i) {
    this.groups.forEach((group, j) => {
      const material = group.children[0]?.material;
      if (material) material.emissive.set(i === j ? 0x3a2c10 : 0x000000);
    });
    this.chosen = i;
  }

  // The largest distance [m] of a body's surface from its centre of mass, over all bodies; and of each.
  reaches() {
    return this.groups.map((group) => {
      let reach = 0;
      for (const mesh of group.children) {
        mesh.updateMatrix();
        const sphere = mesh.geometry.boundingSphere ?? (mesh.geometry.computeBoundingSphere(), mesh.geometry.boundingSphere);
        const ball = sphere.clone().applyMatrix4(mesh.matrix);
        reach = Math.max(reach, ball.center.length() + ball.radius);
      }
      return reach;
    });
  }
}

function geometryOf(surface, buffer) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(arrayOf(buffer, surface.vertices), 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(arrayOf(buffer, surface.normals), 3));
  geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(arrayOf(buffer, surface.triangles)), 1));
  return geometry;
}
