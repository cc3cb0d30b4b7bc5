// Puts the page together and keeps it in step with the clock.
import * as THREE from "three";
import { Bodies, COLOURS } from "jaxrb/bodies";
import { Charts, short } from "jaxrb/charts";
import { Motion } from "jaxrb/motion";
import { Orbit } from "jaxrb/orbit";
import { Contacts, Forces, Impacts, Labels, Trails, volumes } from "jaxrb/overlays";
import { Player, bindKeys } from "jaxrb/player";
import { Stage } from "jaxrb/stage";

const byId = (id) => document.getElementById(id);

export function main(header, buffer) {
  const motion = new Motion(header, buffer);
  const bodies = new Bodies(header, buffer, motion);
  const reach = Math.max(...bodies.reaches(), 1e-9);
  const frame = frameOf(motion, reach);
  const canvas = byId("picture");
  let stage;
  try {
    stage = new Stage(canvas, frame);
  } catch (error) {
    throw new Error(`there is no WebGL here, with which the picture is drawn (${error.message})`);
  }
  header.obstacles.filter((o) => o.plane).forEach((o) => stage.addPlane(o.plane));
  stage.outlines = bodies.line;
  stage.scene.add(...bodies.groups, ...bodies.still);

  let due = false;
  const view = { motion, bodies, frame, reach, canvas, stage, followed: -1 };
  view.draw = () => {
    if (due) return;
    due = true;
    requestAnimationFrame(() => {
      due = false;
      stage.render();
      view.labels.update(bodies.groups, stage.camera, canvas.clientWidth, canvas.clientHeight);
    });
  };
  view.overlays = overlaysOf(view, header, buffer);
  view.labels = new Labels(byId("labels"), header.bodies);
  view.charts = { update() {} };
  stage.fit();
  view.orbit = new Orbit(stage.camera, canvas, frame, view.draw);

  view.player = new Player(motion, (time) => showTime(view, time), (ms) => stage.noteInterval(ms));
  view.charts = new Charts(byId("charts"), header.series, buffer, motion, (time = view.player.time) => view.player.seek(time));
  follower(view, header.bodies);
  describe(view, header);
  paint(view);
  bindKeys(keysOf(view));
  byId("help-open").addEventListener("click", () => byId("help").showModal());
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => paint(view));
  new ResizeObserver(() => {
    const before = stage.camera.aspect;
    stage.fit();
    if (!view.sized) view.orbit.reset(); // the first true size
    view.sized = before !== stage.camera.aspect || view.sized;
    view.draw();
  }).observe(canvas);
  if (motion.count === 1 && frame.radius > 60 * reach) view.follow(0);
  view.player.seek(motion.start);
  Object.assign(window.jaxrb, {
    times: Array.from(motion.times),
    seek: (time) => view.player.seek(time),
    pose: (i) => bodies.pose(i),
    play: () => view.player.play(),
    pause: () => view.player.pause(),
    follow: (i) => view.follow(i),
    arrows: () => view.overlays.reduce((sum, one) => sum + (one.shown ? one.arrows?.used ?? 0 : 0), 0),
    draw: () => stage.render(), // at once, so that the picture can be copied before it is gone
  });
  // Object.assign would copy what a getter gives now.
  Object.defineProperty(window.jaxrb, "time", { get: () => view.player.time });
  Object.defineProperty(window.jaxrb, "frames", { get: () => stage.frames });
}

function showTime(view, time) {
  const at = view.bodies.show(time);
  const group = view.bodies.groups[view.followed];
  if (group?.visible) view.orbit.follow(...group.position.toArray());
  for (const { update, shown } of view.overlays) if (shown) update?.(at, time);
  // Texts that change with every picture cannot be read, and laying them out takes longer than moving the bodies.
  const now = performance.now();
  const told = !view.player?.playing || now - (view.told ?? 0) > 100;
  view.charts.update(time, at, told);
  if (told) view.told = now;
  const where = byId("where");
  where.hidden = !group;
  if (group && told) where.textContent = `${view.names[view.followed]} at (${group.position.toArray().map(short).join(", ")}) m`;
  view.draw();
}

// What has to be in the picture, and along which horizontal axis it reaches farther.
function frameOf(motion, reach) {
  const { low, high } = motion.extent();
  const center = new THREE.Vector3(...low.map((value, axis) => 0.5 * (value + high[axis])));
  const size = low.map((value, axis) => high[axis] - value);
  const half = new THREE.Vector3(...size.map((length) => 0.5 * length + reach));
  return { center, half, radius: 1.08 * (0.5 * Math.hypot(...size) + reach), across: size[1] > 1.01 * size[0] ? 1 : 0 };
}

// Everything that can be shown or not: a name, a key, and how it follows the clock.
function overlaysOf(view, header, buffer) {
  const { motion, bodies, stage, frame, reach } = view;
  const found = [];
  const add = (name, key, shown, toggle, update) => found.push({ name, key, shown, toggle, update });
  const group = (object, update, name, key, shown) => {
    object.visible = shown;
    stage.scene.add(object);
    add(name, key, shown, (on) => { object.visible = on; }, update);
  };
  const trails = new Trails(motion);
  group(trails.group, (at) => trails.update(at, bodies.groups), "Trails", "t", motion.count <= 3);
  add("Labels", "l", false, (on) => { byId("labels").hidden = !on; });
  const kinds = [["ball", "Bounding spheres", "b"], ["box", "Oriented boxes", "o"], ["hull", "Hulls", "h"]];
  for (const [kind, name, key] of kinds) {
    const wires = volumes(kind, header, buffer, bodies.groups);
    const show = (on) => wires.forEach((wire) => { wire.visible = on; });
    show(false);
    if (wires.length) add(name, key, false, show);
  }
  if (header.events) {
    const impacts = new Impacts(header.events, buffer, motion, 0.5 * frame.radius);
    group(impacts.group, (at, time) => impacts.update(time), "Impacts", "i", true);
    found.at(-1).arrows = impacts.arrows;
  }
  if (header.contacts) {
    const contacts = new Contacts(header.contacts, buffer, motion, Math.min(4 * reach, 0.5 * frame.radius), 0xb5541c);
    group(contacts.group, (at) => contacts.update(at), "Contact forces", "p", true);
    found.at(-1).arrows = contacts.arrows;
  }
  header.forces.forEach((entry, k) => {
    const forces = new Forces(entry, buffer, motion, Math.min(4 * reach, 0.5 * frame.radius), COLOURS[(k + 3) % COLOURS.length]);
    group(forces.group, (at) => forces.update(at, bodies.groups), entry.name, "", true);
    found.at(-1).arrows = forces.arrows;
  });
  const box = byId("show");
  for (const one of found) {
    const label = document.createElement("label");
    const input = Object.assign(document.createElement("input"), { type: "checkbox", checked: one.shown });
    input.addEventListener("change", () => {
      one.shown = input.checked;
      one.toggle(one.shown);
      view.player.seek(view.player.time);
    });
    const name = document.createElement("span");
    name.textContent = one.name;
    label.append(input, name);
    box.append(label);
    one.input = input;
  }
  return found;
}

function follower(view, list) {
  view.names = list.map((body) => body.name);
  const select = byId("follow");
  select.append(new Option("nothing", -1), ...list.map((body, i) => new Option(body.name, i)));
  view.follow = (i) => {
    view.followed = i;
    select.value = i;
    view.bodies.choose(i);
    const away = i >= 0 ? 8 * view.reach : undefined;
    if (away && view.orbit.distance > 3 * away) view.orbit.distance = away;
    if (i < 0) view.orbit.reset();
    else view.orbit.follow(...view.bodies.groups[i].position.toArray());
    view.player.seek(view.player.time);
    view.player.say(i < 0 ? "Following nothing" : `Following ${view.names[i]}`);
  };
  select.addEventListener("change", () => view.follow(Number(select.value)));
  const caster = new THREE.Raycaster();
  view.canvas.addEventListener("click", (event) => {
    if (view.orbit.moved > 4) return;
    const box = view.canvas.getBoundingClientRect();
    const at = new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
    caster.setFromCamera(at, view.stage.camera);
    const hit = caster.intersectObjects(view.bodies.groups, true).find((one) => one.object.isMesh);
    if (hit) view.follow(hit.object.parent.userData.body);
  });
}

function describe(view, header) {
  const { motion, canvas, stage } = view;
  const count = `${motion.count} ${motion.count === 1 ? "body" : "bodies"}`;
  const about = `${count}, ${motion.saves} saved states, ${short(motion.start)} to ${short(motion.end)} s`;
  byId("about").textContent = about;
  canvas.setAttribute("aria-label", `Picture of ${header.title}: ${about}. Keys are told by the question mark.`);
  byId("scale").textContent = stage.gridStep ? `grid ${Number(stage.gridStep.toPrecision(1))} m` : "";
  byId("labels").hidden = true;
  const notes = [...header.notes];
  const told = new Map();
  header.bodies.filter((body) => body.note).forEach((body) => told.set(body.note, [...(told.get(body.note) ?? []), body.name]));
  told.forEach((names, note) => {
    const who = names.length > 3 ? `${names.length} bodies` : names.join(", ");
    notes.push(`${who}: ${note}`);
  });
  for (const note of notes) byId("notes").append(Object.assign(document.createElement("li"), { textContent: note }));
}

function paint(view) {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => style.getPropertyValue(name).trim();
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  view.stage.paint({ background: read("--sky"), line: read("--grid"), dark });
  view.draw();
}

function keysOf(view) {
  const { player, orbit, motion } = view;
  const toggle = (key) => view.overlays.find((one) => one.key === key)?.input.click();
  const overlays = view.overlays.filter((one) => one.key);
  return [
    [[" ", "k"], "play, pause", () => player.toggle()],
    [["ArrowLeft", "ArrowRight"], "one saved state back, on", (key) => player.step(key === "ArrowLeft" ? -1 : 1)],
    [["Shift+ArrowLeft", "Shift+ArrowRight", "PageUp", "PageDown"], "a tenth of the run back, on", (key) =>
      player.jump(player.time + (/Left|Up/.test(key) ? -0.1 : 0.1) * (motion.end - motion.start))],
    [["Home", "End"], "to the start, the end", (key) => player.jump(key === "Home" ? motion.start : motion.end)],
    [["ArrowUp", "ArrowDown"], "faster, slower", (key) => player.faster(key === "ArrowUp" ? 1 : -1)],
    [["f"], "follow the next body", () => view.follow(view.followed + 1 < motion.count ? view.followed + 1 : -1)],
    [["c"], "all in the picture again", () => view.follow(-1)],
    [["a", "d"], "turn the camera left, right", (key) => orbit.turn(key === "a" ? 0.1 : -0.1, 0)],
    [["w", "s"], "turn the camera up, down", (key) => orbit.turn(0, key === "w" ? 0.1 : -0.1)],
    [["+", "=", "-"], "nearer, farther", (key) => orbit.nearer(key === "-" ? 1.15 : 1 / 1.15)],
    ...overlays.map((one) => [[one.key], `show ${one.name.toLowerCase()}`, toggle]),
    [["?"], "these keys", () => byId("help").showModal()],
  ];
}
