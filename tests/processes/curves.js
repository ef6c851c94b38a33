// Uses the charts of a page with two runs, and returns what is not as it should be. Run in the page by finished.rs.

const wrong = [];
const check = (what, holds) => { if (!holds) wrong.push(what); };
const chart = health.charts.all.get("entropy, nats");
const press = (key) => chart.place.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
const reading = () => chart.value.textContent;
// uPlot draws, and sets its ends, once the script rests.
const ends = async () => {
  await new Promise(requestAnimationFrame);
  await new Promise(requestAnimationFrame);
  const { min, max } = chart.plot.scales.x;
  return [min, max].join();
};
const last = (name) => Math.max(...model.beside.flatMap(({ points }) => points.map((point) => point[name])));

check("nothing is pointed at", reading() === "");
press("ArrowLeft");
const first = reading();
check(`the last value is told, not ${first}`, /^at .* steps$/.test(first) && chart.reading.querySelectorAll(".dot").length === model.beside.length);
press("ArrowLeft");
check("the value before it is told", reading() !== first);
const whole = await ends();
check(`the axis ends at the last step, not at ${whole}`, whole === `0,${last("n_env_steps")}`);

press("+");
const near = await ends();
check("plus comes nearer", near !== whole);
const { min, max } = [...curves.charts.all.values()][0].plot.scales.x;
check("all charts come nearer", [min, max].join() === near);
press("0");
check("0 shows everything", (await ends()) === whole);

const over = chart.plot.over.getBoundingClientRect();
const mouse = (type, x) => chart.plot.over.dispatchEvent(new MouseEvent(type, {
  bubbles: true, button: 0, clientX: over.left + x * over.width, clientY: over.top + 20, movementX: 1, movementY: 0,
}));
mouse("mousemove", 0.25);
mouse("mousedown", 0.25);
document.dispatchEvent(new MouseEvent("mousemove"));
mouse("mousemove", 0.5);
mouse("mouseup", 0.5);
const [low, high] = (await ends()).split(",").map((value) => value / last("n_env_steps"));
check(`dragging shows a quarter, not ${low} to ${high}`, Math.abs(low - 0.25) < 0.02 && Math.abs(high - 0.5) < 0.02);
mouse("dblclick", 0.5);
check("a double click shows everything", (await ends()) === whole);

const choose = (id, value) => {
  document.getElementById(id).value = value;
  document.getElementById(id).dispatchEvent(new Event("input", { bubbles: true }));
};
const n = chart.plot.series.length;
choose("chart-smoothing", "0.6");
await ends();
check("smoothing keeps the curves as they are behind", chart.plot.series.length === n + model.beside.length);
choose("chart-axis", "elapsed_s");
check("time ends at the last second", (await ends()) === `0,${last("elapsed_s")}`);
document.getElementById("chart-log-x").click();
check("a logarithmic axis begins above 0", Number((await ends()).split(",")[0]) > 0);
document.getElementById("chart-log-x").click();
choose("chart-axis", "n_env_steps");
choose("chart-smoothing", "0");
check("nothing else is left", (await ends()) === whole && chart.plot.series.length === n);
return wrong;
