// The clock, its controls, the keys, and what is told to those who do not see the picture.

const SPEEDS = [1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16, 32, 64, 256, 1024];
const LONGEST = 20; // seconds that a run takes to play, unless somebody wants it slower
const PLAY = "M4 2.5v11L13.5 8z";
const PAUSE = "M4 3v10M5 3v10M11 3v10M12 3v10";

const byId = (id) => document.getElementById(id);

export class Player {
  constructor(motion, shown, noted) {
    this.motion = motion;
    this.noted = noted; // with the time between two pictures while playing [ms]
    this.shown = shown; // called with each new time
    this.time = motion.start;
    this.playing = false;
    this.still = window.matchMedia("(prefers-reduced-motion: reduce)");
    this.#speeds();
    this.scrub = byId("scrub");
    Object.assign(this.scrub, { min: motion.start, max: motion.end, value: motion.start });
    this.scrub.disabled = byId("play").disabled = !(motion.end > motion.start);
    this.scrub.addEventListener("input", () => this.seek(Number(this.scrub.value)));
    byId("play").addEventListener("click", () => this.toggle());
    byId("back").addEventListener("click", () => this.step(-1));
    byId("forth").addEventListener("click", () => this.step(1));
    this.#show();
  }

  #speeds() {
    const span = this.motion.end - this.motion.start;
    const select = byId("speed");
    for (const speed of SPEEDS) {
      const name = speed < 1 ? `1/${1 / speed} ×` : `${speed} ×`;
      select.append(new Option(name, speed));
    }
    const fit = SPEEDS.findIndex((speed) => span / speed <= LONGEST);
    const real = SPEEDS.indexOf(1);
    // As fast as it was, except what is over in a blink or takes too long to watch.
    const chosen = span < 0.25 ? SPEEDS.findLastIndex((speed) => span / speed >= 1.5) : Math.max(real, fit);
    select.selectedIndex = fit < 0 ? SPEEDS.length - 1 : Math.max(0, chosen);
    select.addEventListener("change", () => this.say(`Speed ${this.speedName}`));
  }

  get speed() {
    return Number(byId("speed").value);
  }

  get speedName() {
    return byId("speed").selectedOptions[0].textContent;
  }

  faster(by) {
    const select = byId("speed");
    select.selectedIndex = Math.max(0, Math.min(SPEEDS.length - 1, select.selectedIndex + by));
    this.say(`Speed ${this.speedName}`);
  }

  seek(time) {
    this.time = this.motion.clamp(time);
    this.#show();
  }

  // So many saved states on; a time between two counts as after the first.
  step(by) {
    this.pause();
    const { save, fraction } = this.motion.at(this.time);
    const from = by < 0 && fraction > 0 ? save + 1 : save;
    const to = Math.max(0, Math.min(this.motion.saves - 1, from + by));
    this.seek(this.motion.times[to]);
    this.say(this.clock());
  }

  jump(time) {
    this.seek(time);
    this.say(this.clock());
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.playing || !(this.motion.end > this.motion.start)) return;
    if (this.time >= this.motion.end) this.seek(this.motion.start);
    this.playing = true;
    this.#button("Pause", PAUSE);
    this.say(`Playing from ${this.clock()}`);
    let before = performance.now();
    let first = true;
    const tick = (now) => {
      if (!this.playing) return;
      const since = Math.max(0, now - before); // the first picture's time can lie before the call
      if (!first) this.noted(since);
      first = false;
      this.seek(this.time + (this.speed * since) / 1000);
      before = now;
      if (this.time >= this.motion.end) this.pause();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.#show();
    this.#button("Play", PLAY);
    this.say(`Paused at ${this.clock()}`);
  }

  #button(name, icon) {
    byId("play").setAttribute("aria-label", name);
    byId("play-icon").setAttribute("d", icon);
  }

  clock() {
    return `${this.#digits(this.time)} s`;
  }

  #digits(time) {
    const span = this.motion.end - this.motion.start || 1;
    return time.toFixed(Math.max(0, Math.min(9, 3 - Math.floor(Math.log10(span)))));
  }

  #show() {
    this.scrub.value = this.time;
    this.scrub.setAttribute("aria-valuetext", this.clock());
    const share = (this.time - this.motion.start) / (this.motion.end - this.motion.start || 1);
    this.scrub.style.setProperty("--share", `${(100 * share).toFixed(2)}%`);
    byId("time").textContent = `${this.#digits(this.time)} / ${this.#digits(this.motion.end)} s`;
    this.shown(this.time);
  }

  say(text) {
    byId("live").textContent = text;
  }
}

// `keys`: [names of keys, what they do, function]. Keys go to the page wherever the focus is, except where it is on
// something that uses them itself.
export function bindKeys(keys) {
  for (const [names, about] of keys) {
    const row = byId("keys").insertRow();
    const cell = row.insertCell();
    names.filter((name) => !name.startsWith("Shift+")).forEach((name) => {
      const key = document.createElement("kbd");
      key.textContent = SIGNS[name] ?? name;
      cell.append(key, " ");
    });
    row.insertCell().textContent = about;
  }
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || byId("help").open) return;
    const on = event.target.tagName;
    if (on === "SELECT" || (on === "BUTTON" && [" ", "Enter"].includes(event.key))) return;
    if (on === "INPUT" && event.target.type === "checkbox" && event.key === " ") return;
    const wanted = event.shiftKey && event.key.length > 1 ? `Shift+${event.key}` : event.key;
    const found = keys.find(([names]) => names.includes(wanted));
    if (!found) return;
    event.preventDefault();
    found[2](wanted);
  });
}

const SIGNS = { " ": "space", ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓" };

