// Where an axis has its marks: at round numbers.

/** Round durations in seconds; beyond the last, round numbers of days. */
const DURATIONS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400];

/**
 * Returns the smallest round number that is at least `rough`, times `unit`.
 * @param {number} rough
 * @param {number} unit
 */
function round(rough, unit) {
  const power = unit * 10 ** Math.floor(Math.log10(rough / unit));
  // A quotient just above a round number is that number.
  return power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999999);
}

/**
 * Returns about `n` round numbers from `low` to `high`.
 * @param {number} low
 * @param {number} high
 * @param {number} n
 * @param {boolean} isTime whether they are seconds
 */
export function ticks(low, high, n, isTime = false) {
  if (!(high > low)) return [low];
  const rough = (high - low) / n;
  const step = (isTime && DURATIONS.find((duration) => duration >= rough)) || round(rough, isTime && rough > 1 ? 86400 : 1);
  const first = Math.ceil(low / step - 1e-6);
  const count = Math.floor(high / step + 1e-6) - first + 1;
  return Array.from({ length: Math.max(count, 0) }, (_, i) => (first + i) * step);
}

/**
 * Returns about `n` numbers from `low` to `high` for a logarithmic axis: powers of ten, their multiples by 2 and 5 where
 * there is room, or round numbers if the axis is too short for those.
 * @param {number} low above 0
 * @param {number} high
 * @param {number} n
 */
export function logTicks(low, high, n) {
  const [from, to] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
  const powers = Array.from({ length: to - from + 1 }, (_, i) => 10 ** (from + i));
  const inside = (/** @type {number[]} */ values) => values.filter((value) => value >= low * 0.999999 && value <= high * 1.000001);
  const some = inside(powers);
  if (some.length > n) return some.filter((_, i) => i % Math.ceil(some.length / n) === 0);
  const more = inside(powers.flatMap((power) => [power, 2 * power, 5 * power]));
  if (more.length <= n + 1 && more.length > 1) return more;
  return some.length > 1 ? some : ticks(low, high, n);
}
