// Success by group against environment steps, with 95 % intervals, and the table of the newest evaluation.

import { count, element, fill, interval, minutes, percent, svg } from "./format.js";

/** @import { Acting, History, Pass, Rate } from "./types" */

const GROUPS = ["train 2-6", "train 7-11", "train 12-16", "test 12-16", "test special", "validation 2-6", "validation", "all"];
/** Curves with fewer points than this have visible dots. */
const MAX_DOTS = 40;

/** Dash patterns of the curves `g0`, `g1`, …, which differ in more than their color. */
export const DASHES = ["none", "7 3", "2 3", "9 3 2 3", "5 5", "7 2 1 2", "1 2"];

/**
 * Creates an empty chart of rates (0 to 1) against environment steps (0 to `most`), with its coordinate functions.
 * @param {HTMLElement} place where it will be shown
 * @param {number} most
 * @param {string} label
 */
function rateAxes(place, most, label) {
  const width = Math.max(Math.min(place.clientWidth || 700, 1160), 260);
  const [height, left, right, top, bottom] = [width < 500 ? 200 : 260, 44, 10, 8, 26];
  const x = (/** @type {number} */ steps) => left + (steps / most) * (width - left - right);
  const y = (/** @type {number} */ rate) => top + (1 - rate) * (height - top - bottom);
  const drawing = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
  for (const rate of [0, 0.25, 0.5, 0.75, 1]) {
    drawing.append(svg("line", { class: "grid", x1: left, x2: width - right, y1: y(rate), y2: y(rate) }));
    drawing.append(svg("text", { x: left - 6, y: y(rate) + 4, "text-anchor": "end" }, `${100 * rate} %`));
  }
  for (const steps of ticks(most, width < 500 ? 3 : 6)) {
    const anchor = x(steps) > width - 30 ? "end" : "middle";
    drawing.append(svg("text", { x: x(steps), y: height - 8, "text-anchor": anchor }, steps === 0 ? "0 steps" : count(steps)));
  }
  return { drawing, x, y };
}

/**
 * Returns round numbers from 0 to `most`, about `n` of them.
 * @param {number} most
 * @param {number} n
 */
function ticks(most, n) {
  if (most < n) return [0];
  const rough = most / n;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const all = [];
  for (let at = 0; at <= most * 1.0001; at += step) all.push(at);
  return all;
}

/**
 * Draws success by group. Before the first evaluation ends, shows the preliminary numbers of `now`, if any.
 * @param {HTMLElement} place
 * @param {History} history
 * @param {Acting} acting
 * @param {{ success: Rate, text: string } | null} now
 */
export function drawCurves(place, history, acting, now) {
  const passes = history.passes.filter((pass) => pass.all[acting]);
  if (passes.length === 0) {
    const soFar = now ? `${percent(now.success.rate)} so far, ${now.text}.` : "No evaluation yet; the first comes with the first weights.";
    place.replaceChildren(element("p", { class: "empty" }, soFar));
    return;
  }
  if (passes.length === 1) {
    // The table below already shows all numbers.
    place.replaceChildren();
    return;
  }
  const last = passes[passes.length - 1];
  const said = last.groups.filter((group) => group[acting]).map((group) => `${group.name} ${percent(group[acting].rate)}`);
  const label = `Success by group over ${passes.length} evaluations; newest: ${said.join(", ") || percent(last.all[acting].rate)}`;
  const { drawing, x, y } = rateAxes(place, Math.max(...passes.map((pass) => pass.n_env_steps), 1), label);
  GROUPS.forEach((name, i) => {
    const points = passes
      .map((pass) => ({ steps: pass.n_env_steps, rate: pass.groups.find((group) => group.name === name)?.[acting] }))
      .filter((point) => point.rate);
    if (points.length === 0) return;
    const upper = points.map((point) => `${x(point.steps)},${y(point.rate.wilson_high)}`);
    const lower = points.map((point) => `${x(point.steps)},${y(point.rate.wilson_low)}`).reverse();
    drawing.append(svg("polygon", { class: `band g${i}`, points: [...upper, ...lower].join(" ") }));
    const line = points.map((point) => `${x(point.steps)},${y(point.rate.rate)}`).join(" ");
    drawing.append(svg("polyline", { class: `curve g${i}`, "stroke-dasharray": DASHES[i], points: line }));
    // Dots that touch would hide the line. Invisible ones still show tooltips.
    const look = points.length < MAX_DOTS ? { class: `g${i}`, r: 2.5 } : { class: "unseen", r: 5 };
    points.forEach((point) => drawing.append(svg("circle", { ...look, cx: x(point.steps), cy: y(point.rate.rate) },
      svg("title", {}, `${name}, ${count(point.steps)} steps: ${percent(point.rate.rate)} (${interval(point.rate)})`))));
  });
  place.replaceChildren(drawing);
}

/**
 * Shows the newest evaluation by group.
 * @param {HTMLTableElement} table
 * @param {History} history
 */
export function drawGroups(table, history) {
  const last = history.passes[history.passes.length - 1];
  if (!last) {
    table.replaceChildren();
    return;
  }
  const cells = (/** @type {Rate | null} */ rate) => (rate ? [percent(rate.rate), interval(rate), String(rate.n_episodes)] : ["–", "–", "–"]);
  const rows = [...last.groups, last.all].map((group) => {
    const i = GROUPS.indexOf(group.name);
    const dot = svg("svg", { class: "dot", viewBox: "0 0 22 12", "aria-hidden": "true" },
      svg("line", { class: `curve g${i}`, x1: 0, x2: 22, y1: 6, y2: 6, "stroke-dasharray": DASHES[i] }));
    const first = group.name === "all" ? ["all"] : [dot, group.name];
    return [first, String(group.n_blueprints), ...cells(group.greedy), ...cells(group.sampled)];
  });
  const caption = `Newest evaluation: weights ${last.weights_version}, ${count(last.n_env_steps)} steps, took ${minutes(last.elapsed_s)}`;
  const heads = ["group", "blueprints", "greedy", "95 % interval", "episodes", "sampled", "95 % interval", "episodes"];
  fill(table, caption, heads, rows);
}

/**
 * Draws success on all blueprints against environment steps, several runs in one chart.
 * @param {HTMLElement} place
 * @param {{ name: string, history: History }[]} runs
 * @param {Acting} acting
 */
export function drawBeside(place, runs, acting) {
  const curves = runs.map(({ name, history }) => ({
    name,
    points: history.passes.filter((pass) => pass.all[acting]).map((pass) => ({ steps: pass.n_env_steps, rate: pass.all[acting].rate })),
  }));
  const newest = (/** @type {{ points: { rate: number }[] }} */ { points }) => (points.length > 0 ? percent(points[points.length - 1].rate) : "no evaluation");
  const label = `Success over environment steps; at last: ${curves.map((curve) => `${curve.name} ${newest(curve)}`).join(", ")}`;
  const { drawing, x, y } = rateAxes(place, Math.max(...curves.flatMap(({ points }) => points.map(({ steps }) => steps)), 1), label);
  const names = curves.map((curve, i) => {
    const [style, dashes] = [`g${i % GROUPS.length}`, DASHES[i % DASHES.length]];
    const line = curve.points.map(({ steps, rate }) => `${x(steps)},${y(rate)}`).join(" ");
    drawing.append(svg("polyline", { class: `curve ${style}`, "stroke-dasharray": dashes, points: line }));
    curve.points.forEach(({ steps, rate }) => drawing.append(svg("circle", { class: style, cx: x(steps), cy: y(rate), r: 2.5 },
      svg("title", {}, `${curve.name}, ${count(steps)} steps: ${percent(rate)}`))));
    const dot = svg("svg", { class: "dot", viewBox: "0 0 22 12", "aria-hidden": "true" },
      svg("line", { class: `curve ${style}`, x1: 0, x2: 22, y1: 6, y2: 6, "stroke-dasharray": dashes }));
    return element("span", {}, dot, `${curve.name}: ${newest(curve)}`);
  });
  place.replaceChildren(drawing, element("p", { class: "options" }, ...names));
}
