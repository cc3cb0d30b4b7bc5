// The run's numbers, and where each body is at any time.

// The array that stands in the header as {at, shape, type}.
export function arrayOf(buffer, entry) {
  const Kind = { f8: Float64Array, f4: Float32Array, i4: Int32Array }[entry.type];
  const count = entry.shape.reduce((product, n) => product * n, 1);
  return new Kind(buffer, entry.at, count);
}

export class Motion {
  constructor(header, buffer) {
    this.times = arrayOf(buffer, header.times);
    this.position = arrayOf(buffer, header.position);
    this.orientation = arrayOf(buffer, header.orientation); // w x y z
    this.saves = this.times.length;
    this.count = header.position.shape[1];
    this.start = this.times[0];
    this.end = this.times[this.saves - 1];
  }

  clamp(time) {
    return Math.min(Math.max(time, this.start), this.end);
  }

  // The last saved state that is not after `time`, and how far on towards the next the time lies, in [0, 1).
  at(time) {
    let low = 0;
    let high = this.saves - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= time) low = middle;
      else high = middle - 1;
    }
    if (low === this.saves - 1) return { save: low, fraction: 0 };
    const fraction = (time - this.times[low]) / (this.times[low + 1] - this.times[low]);
    return { save: low, fraction: Math.max(fraction, 0) };
  }

  // Position of body i into out[0..2].
  placeOf(i, { save, fraction }, out) {
    const here = 3 * (save * this.count + i);
    const there = here + (fraction > 0 ? 3 * this.count : 0);
    for (let axis = 0; axis < 3; axis += 1) {
      const from = this.position[here + axis];
      out[axis] = fraction > 0 ? from + fraction * (this.position[there + axis] - from) : from;
    }
    return out;
  }

  // Orientation of body i, w x y z, into out[0..3]: slerp, the short way round (Shoemake 1985).
  turnOf(i, { save, fraction }, out) {
    const q = this.orientation;
    const here = 4 * (save * this.count + i);
    if (fraction === 0) {
      for (let k = 0; k < 4; k += 1) out[k] = q[here + k];
      return out;
    }
    const there = here + 4 * this.count;
    let cosine = 0;
    for (let k = 0; k < 4; k += 1) cosine += q[here + k] * q[there + k];
    const sign = cosine < 0 ? -1 : 1;
    // The angle from the chord, not from the cosine, which tells small angles badly.
    let chord = 0;
    for (let k = 0; k < 4; k += 1) chord += (sign * q[there + k] - q[here + k]) ** 2;
    const angle = 2 * Math.asin(Math.min(1, 0.5 * Math.sqrt(chord)));
    const whole = Math.sin(angle);
    const a = whole > 0 ? Math.sin((1 - fraction) * angle) / whole : 1 - fraction;
    const b = sign * (whole > 0 ? Math.sin(fraction * angle) / whole : fraction);
    let length = 0;
    for (let k = 0; k < 4; k += 1) {
      out[k] = a * q[here + k] + b * q[there + k];
      length += out[k] * out[k];
    }
    length = Math.sqrt(length);
    for (let k = 0; k < 4; k += 1) out[k] /= length;
    return out;
  }

  // The ball that holds all finite positions of the run: centre, radius, and reach along each axis.
  extent() {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (let j = 0; j < this.position.length; j += 1) {
      const value = this.position[j];
      if (Number.isFinite(value)) {
        low[j % 3] = Math.min(low[j % 3], value);
        high[j % 3] = Math.max(high[j % 3], value);
      }
    }
    if (!low.every(Number.isFinite)) return { low: [0, 0, 0], high: [0, 0, 0] };
    return { low, high };
  }
}
