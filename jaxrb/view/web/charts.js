// Curves over time, drawn as SVG: energy, angular momentum, drift. A click goes to that time.
import { arrayOf } from "jaxrb/motion";

const [WIDTH, HEIGHT] = [300, 84];
const MOST_POINTS = 600;
const SVG = "http://www.w3.org/2000/svg"; // the name of a language, not an address to be asked

export class Charts {
  constructor(parent, series, buffer, motion, seek) {
    this.motion = motion;
    this.charts = series.map((one) => this.#chart(parent, one, buffer, seek));
    this.width = 0;
    new ResizeObserver(() => {
      this.width = parent.clientWidth;
      seek();
    }).observe(parent);
  }

  #chart(parent, { title, unit, lines }, buffer, seek) {
    const rows = lines.map(({ name, values }) => ({ name, values: arrayOf(buffer, values) }));
    const [low, high] = rangeOf(rows.map((row) => row.values));
    const figure = element(parent, "figure");
    const caption = element(figure, "figcaption");
    element(caption, "span", "title").textContent = title;
    element(caption, "span", "unit").textContent = unit === "1" ? "" : unit;
    const plot = element(figure, "div", "plot");
    const svg = plot.appendChild(shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none" }));
    svg.setAttribute("role", "img");
    // What never changes is a line in the middle.
    const y = (value) => 4 + (HEIGHT - 8) * (high > low ? 1 - (value - low) / (high - low) : 0.5);
    const { start, end } = this.motion;
    const x = (time) => (end > start ? (WIDTH * (time - start)) / (end - start) : 0);
    if (low < 0 && high > 0) svg.append(shape("line", { x1: 0, x2: WIDTH, y1: y(0), y2: y(0), class: "zero" }));
    rows.forEach((row, k) => svg.append(this.#line(row.values, x, y, k)));
    // Not in the SVG: moving it would draw the curves again, which took half of a picture's time.
    const cursor = element(plot, "div", "cursor");
    const key = element(figure, "div", "key");
    rows.forEach((row, k) => {
      const item = element(key, "span", `line-${k}`);
      row.text = item;
    });
    const bounds = element(plot, "div", "range");
    element(bounds, "span").textContent = short(high);
    if (high > low) element(bounds, "span").textContent = short(low);
    const told = rows.map((row) => `${row.name} from ${short(row.values[0])} to ${short(row.values.at(-1))}`);
    svg.setAttribute("aria-label", `${title}, ${unit}: ${told.join("; ")}; between ${short(low)} and ${short(high)}`);
    const go = (event) => {
      const box = svg.getBoundingClientRect();
      seek(start + ((event.clientX - box.left) / box.width) * (end - start));
    };
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      go(event);
    });
    svg.addEventListener("pointermove", (event) => event.buttons && go(event));
    return { cursor, rows, x };
  }

  // With many saves each stretch of them is drawn by its least and greatest value: no peak is lost.
  #line(values, x, y, k) {
    const { times } = this.motion;
    const stride = Math.max(1, Math.ceil(values.length / MOST_POINTS));
    const path = [];
    let pen = "M";
    for (let from = 0; from < values.length; from += stride) {
      const stretch = [...values.subarray(from, from + stride)].filter(Number.isFinite);
      if (!stretch.length) {
        pen = "M";
        continue;
      }
      const ends = stride === 1 ? stretch : [Math.min(...stretch), Math.max(...stretch)];
      for (const value of ends) {
        path.push(`${pen}${x(times[from]).toFixed(2)} ${y(value).toFixed(2)}`);
        pen = "L";
      }
    }
    return shape("path", { d: path.join(""), class: `line line-${k}` });
  }

  update(time, { save, fraction }, told) {
    for (const { cursor, rows, x } of this.charts) {
      // By whole points of the screen: less is not seen, and each move is drawn.
      const moved = `translateX(${Math.round((x(time) / WIDTH) * (this.width - 3))}px)`;
      if (cursor.style.transform !== moved) cursor.style.transform = moved;
      if (told) rows.forEach(({ name, values, text }) => {
        const here = values[save];
        const value = fraction > 0 ? here + fraction * (values[save + 1] - here) : here;
        text.textContent = `${name} ${short(value)}`;
      });
    }
  }
}

function rangeOf(rows) {
  let [low, high] = [Infinity, -Infinity];
  for (const row of rows) {
    for (const value of row) {
      if (Number.isFinite(value)) {
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
    }
  }
  return low <= high ? [low, high] : [0, 0];
}

export function short(value) {
  if (!Number.isFinite(value)) return "not finite";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e4 || size < 1e-3 ? value.toExponential(1) : value.toPrecision(3);
  return text.replace("-", "−").replace(/e\+?/, "e").replace("e-", "e−");
}

function element(parent, kind, name = "") {
  const made = document.createElement(kind);
  if (name) made.className = name;
  return parent.appendChild(made);
}

function shape(kind, attributes) {
  const made = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}
