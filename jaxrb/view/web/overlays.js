// What is shown on demand: trails, bounding volumes, hulls, labels, impacts and forces.
import * as THREE from "three";
import { arrayOf } from "jaxrb/motion";
import { COLOURS } from "jaxrb/bodies";

const MOST_LABELS = 80;
const MOST_CONTACTS = 1000; // arrows at a time

export class Trails {
  constructor(motion) {
    this.motion = motion;
    this.group = new THREE.Group();
    const { count, saves, position } = motion;
    this.lines = Array.from({ length: count }, (_, i) => {
      const points = new Float32Array(3 * (saves + 1));
      for (let k = 0; k < saves; k += 1) {
        for (let axis = 0; axis < 3; axis += 1) points[3 * k + axis] = position[3 * (k * count + i) + axis];
      }
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
      const material = new THREE.LineBasicMaterial({ color: COLOURS[i % COLOURS.length] });
      const line = new THREE.Line(geometry, material);
      line.frustumCulled = false;
      this.group.add(line);
      return { line, points, original: points.slice() };
    });
    this.tip = 0;
  }

  // Up to now: saved points, and one more where the body is.
  update(at, groups) {
    if (!this.group.visible) return;
    this.lines.forEach(({ line, points, original }, i) => {
      points.set(original.subarray(3 * this.tip, 3 * this.tip + 3), 3 * this.tip);
      groups[i].position.toArray(points, 3 * (at.save + 1));
      line.geometry.attributes.position.needsUpdate = true;
      line.geometry.setDrawRange(0, at.save + 2);
    });
    this.tip = at.save + 1;
  }
}

// Wire pictures of one kind of bounding volume, each a child of its body's group.
export function volumes(kind, header, buffer, groups) {
  const material = new THREE.LineBasicMaterial({ color: 0xb5541c, transparent: true, opacity: 0.8 });
  const wires = [];
  header.bodies.forEach((body, i) => {
    if (body[kind] === undefined) return;
    const wire = new THREE.LineSegments(WIRES[kind](body[kind], buffer), material);
    wire.userData.raycast = false;
    wire.raycast = () => {};
    wires.push(wire);
    groups[i].add(wire);
  });
  return wires;
}

const WIRES = {
  ball([x, y, z, radius]) {
    const points = [];
    for (const axis of [0, 1, 2]) {
      for (let k = 0; k < 48; k += 1) {
        for (const end of [k, k + 1]) {
          const angle = (2 * Math.PI * end) / 48;
          const at = [0, 0, 0];
          at[(axis + 1) % 3] = radius * Math.cos(angle);
          at[(axis + 2) % 3] = radius * Math.sin(angle);
          points.push(...at);
        }
      }
    }
    return linesOf(points).translate(x, y, z);
  },
  box([x, y, z, w, a, b, c, ...half]) {
    const edges = new THREE.EdgesGeometry(new THREE.BoxGeometry(...half.map((h) => 2 * h)));
    return edges.applyQuaternion(new THREE.Quaternion(a, b, c, w)).translate(x, y, z);
  },
  hull: (entry, buffer) => linesOf(arrayOf(buffer, entry)),
};

function linesOf(points) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  return geometry;
}

// Arrows of one length scale: the largest is half of what is seen.
class Arrows {
  constructor(colour, longest, most) {
    this.group = new THREE.Group();
    this.longest = longest;
    this.arrows = Array.from({ length: most }, () => {
      const arrow = new THREE.ArrowHelper(new THREE.Vector3(0, 0, 1), new THREE.Vector3(), 1, colour);
      arrow.visible = false;
      // Before all bodies: a force of contact points into the body that it pushes, weight starts within.
      for (const part of [arrow.line, arrow.cone]) {
        Object.assign(part.material, { depthTest: false, transparent: true });
        part.renderOrder = 2;
      }
      this.group.add(arrow);
      return arrow;
    });
    this.used = 0;
  }

  begin() {
    this.used = 0;
  }

  add(x, y, z, vector, largest) {
    const length = vector.length();
    const arrow = this.arrows[this.used];
    if (!arrow || !(length > 1e-6 * largest)) return;
    this.used += 1;
    arrow.visible = true;
    arrow.position.set(x, y, z);
    arrow.setDirection(vector.clone().divideScalar(length));
    const shown = this.longest * Math.max(length / largest, 0.04);
    arrow.setLength(shown, Math.min(0.3 * shown, 0.12 * this.longest), Math.min(0.15 * shown, 0.06 * this.longest));
  }

  end() {
    for (let k = this.used; k < this.arrows.length; k += 1) this.arrows[k].visible = false;
  }
}

// The impacts of a run whose impacts were located: a dot and the impulse, for a moment after each.
export class Impacts {
  constructor(events, buffer, motion, size) {
    this.time = arrayOf(buffer, events.time);
    this.point = arrayOf(buffer, events.point);
    this.impulse = arrayOf(buffer, events.impulse);
    this.lasting = 0.04 * (motion.end - motion.start) || 1;
    this.arrows = new Arrows(0xb5541c, size, 24);
    this.group = this.arrows.group;
    this.largest = largestOf(this.impulse);
  }

  update(time) {
    this.arrows.begin();
    for (let k = 0; k < this.time.length; k += 1) {
      const since = time - this.time[k];
      if (since < 0 || since > this.lasting) continue;
      const vector = new THREE.Vector3().fromArray(this.impulse, 3 * k);
      this.arrows.add(...this.point.subarray(3 * k, 3 * k + 3), vector, this.largest);
    }
    this.arrows.end();
  }
}

// Forces of one effect, at the bodies' centres of mass, between saved states in proportion.
export class Forces {
  constructor(entry, buffer, motion, size, colour) {
    this.values = arrayOf(buffer, entry.values);
    this.motion = motion;
    this.arrows = new Arrows(colour, size, motion.count);
    this.group = this.arrows.group;
    this.largest = largestOf(this.values);
  }

  update(at, groups) {
    const { count } = this.motion;
    this.arrows.begin();
    groups.forEach((group, i) => {
      const here = new THREE.Vector3().fromArray(this.values, 3 * (at.save * count + i));
      if (at.fraction > 0) {
        const there = new THREE.Vector3().fromArray(this.values, 3 * ((at.save + 1) * count + i));
        here.lerp(there, at.fraction);
      }
      if (group.visible) this.arrows.add(...group.position.toArray(), here, this.largest);
    });
    this.arrows.end();
  }
}

// Forces of contact where they press, at the saved state that is nearest: between two, points come and go.
export class Contacts {
  constructor(entry, buffer, motion, size, colour) {
    this.first = arrayOf(buffer, entry.first);
    this.point = arrayOf(buffer, entry.point);
    this.force = arrayOf(buffer, entry.force);
    let most = 0;
    for (let k = 1; k < this.first.length; k += 1) most = Math.max(most, this.first[k] - this.first[k - 1]);
    this.arrows = new Arrows(colour, size, Math.min(most, MOST_CONTACTS));
    this.group = this.arrows.group;
    this.largest = largestOf(this.force);
  }

  update(at) {
    const save = at.save + (at.fraction > 0.5 ? 1 : 0);
    this.arrows.begin();
    for (let k = this.first[save]; k < this.first[save + 1]; k += 1) {
      const vector = new THREE.Vector3().fromArray(this.force, 3 * k);
      this.arrows.add(...this.point.subarray(3 * k, 3 * k + 3), vector, this.largest);
    }
    this.arrows.end();
  }
}

function largestOf(vectors) {
  let largest = 0;
  for (let k = 0; k < vectors.length; k += 3) {
    const size = Math.hypot(vectors[k], vectors[k + 1], vectors[k + 2]);
    if (size > largest) largest = size;
  }
  return largest || 1;
}

// Names beside the bodies, as text of the page, so that they stay sharp and no name is ever markup.
export class Labels {
  constructor(parent, bodies) {
    this.parent = parent;
    this.tags = bodies.slice(0, MOST_LABELS).map((body) => {
      const tag = document.createElement("span");
      tag.textContent = body.name;
      parent.append(tag);
      return tag;
    });
    this.at = new THREE.Vector3();
  }

  update(groups, camera, width, height) {
    if (this.parent.hidden) return;
    this.tags.forEach((tag, i) => {
      this.at.copy(groups[i].position).project(camera);
      const seen = groups[i].visible && Math.abs(this.at.z) < 1;
      tag.hidden = !seen;
      if (!seen) return;
      const x = 0.5 * (this.at.x + 1) * width;
      const y = 0.5 * (1 - this.at.y) * height;
      tag.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -50%)`;
    });
  }
}
