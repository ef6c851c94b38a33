// Looks at what is on the screen of a finished run's page, and returns what is not as it should be. Run by finished.rs,
// which opens the page with choices in its address.

const wrong = [];
const check = (what, holds) => { if (!holds) wrong.push(what); };
const part = (id) => document.getElementById(id);
const until = async (holds) => { while (!holds()) await new Promise((again) => setTimeout(again, 20)); };
const rect = (id) => part(id).getBoundingClientRect();

await until(() => heat.at && health.charts.all.size > 0 && replay.episode?.blueprint === "2_000" && rect("replay").height > 0);
const { options } = health;
check("the search comes back", part("heat-find").value === "5_0" && heat.words === "5_0");
check("all at a glance comes back", part("heat-whole").checked);
check("the actions come back", model.acting === "sampled" && document.querySelector("#acting input:checked").value === "sampled");
check("the logarithmic axis comes back", part("chart-log-y").checked && options.isLogY && !options.isLogX);
check("the zoom comes back", options.range?.join() === "100,600" && !part("chart-whole").disabled);
check(`they stay in ${location.search}`, ["find=5_0", "actions=sampled", "log=y", "zoom=100", "whole=1"].every((one) => location.search.includes(one)));

document.querySelector("#acting input[value=greedy]").click();
await until(() => heat.acting === "greedy" && heat.evaluations.length > 1);
const [mark] = part("heat-axis").children;
const [end, edge] = [model.history.learner.at(-1).n_env_steps, heat.at.edges.at(-1)];
check(`the heat map ends with step ${end}, not ${mark.textContent}`, mark.textContent === `${end} steps`);
check("and there its last column ends", Math.abs(Number.parseFloat(mark.style.left) - edge) < 1 && edge <= part("heat").clientWidth + 1);
const controls = ["replay-play", "replay-slider", "stage-bar", "hand-bar"];
check("the picture is above its controls", controls.every((id) => rect(id).top >= rect("replay").bottom));

part("draw-open").click();
await until(() => editor.desk && editor.found.blocks && Math.abs(rect("draw-open").top) < 1);
check(`the board is on the screen, not ${rect("draw-canvas").top} to ${rect("draw-canvas").bottom}`, rect("draw-canvas").bottom <= innerHeight);
const checked = async (how) => {
  const { found } = editor;
  how();
  await until(() => editor.found !== found && editor.found.blocks);
};
for (const type of ["2x1x1", "2x1x1", "1x1x1", "1x1x1", "1x1x1", "1x1x1"]) {
  await checked(() => {
    editor.choose(type);
    editor.placeNext();
  });
  const { at } = editor.blocks.at(-1);
  check(`the ${type} at ${at} is in view`, editor.desk.sees({ at, size: editor.cells(type, editor.blocks.at(-1).axes) }));
}
const axes = () => editor.blocks.map((block) => block.axes);
const [first, ...others] = axes();
editor.pick(0);
await checked(() => editor.act("turn"));
check("Turn turns a block", axes()[0] !== first);
check("and leaves the poles of the others", axes().slice(1).join() === others.join());
await checked(() => editor.act("clear"));
return wrong;
