// Asks for the verdicts of handmade ends, and returns those that are not as they should be. Run in the page by browser.rs.

const { verdict } = await from("verdict.js");
const names = ["wall", "roof", "lamp"];
// Two links, or three.
const [chain, ring] = [[[0, 1], [1, 2]], [[0, 1], [0, 2], [1, 2]]];
const told = (links, joints) => {
  const scene = { n_connected: joints.filter(([, , isRight]) => isRight).length, joints };
  const episode = { goal: names.map((_, block) => [block]), links, names, step_s: 0.1, end: "time limit", scenes: [scene, scene] };
  return verdict(episode, 1).text.split("; ").slice(1).join("; ");
};
const all = [
  [told(chain, [[0, 1, true]]), "lamp is not in place"],
  [told(chain, [[0, 1, false], [1, 2, true]]), "roof on wall hangs by a wrong pole"],
  [told(chain, [[0, 1, false]]), "lamp is not in place; roof on wall hangs by a wrong pole"],
  [told(chain, [[0, 1, true], [0, 2, false]]), "lamp is not in place; lamp on wall does not belong there"],
  [told(ring, [[0, 1, true], [1, 2, true]]), "lamp to wall is not connected"],
];
return all.filter(([is, wanted]) => is !== wanted);
