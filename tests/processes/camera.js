// Returns four numbers: how many blocks that are in place or held lie outside the camera's box, over all scenes of the
// episode; how much larger the final box is than the structure, in meters; how much of the picture's half width or
// height that box fills; and how far it is beside or below the goal in the corner, in pixels. Run by browser.rs.

const { episode: { scenes, goal }, follow, space } = replay.main;
const isBuilt = (scene, block, pose) => apart3(scene.blocks[block], placed(scene.goal_frame, pose)) < 0.02;
const lost = scenes.flatMap((scene, i) => goal.filter(([block, pose]) => {
  const [low, high] = follow.at(i);
  const at = scene.blocks[block];
  const isInside = [0, 1, 2].every((axis) => low[axis] <= at[axis] && at[axis] <= high[axis]);
  return (isBuilt(scene, block, pose) || scene.held.includes(block)) && !isInside;
}));
const box = follow.at(Infinity);
const reaches = [0, 1, 2].map((axis) => goal.map(([block]) => scenes[replay.n].blocks[block][axis]));
const length = Math.hypot(...reaches.map((values) => Math.max(...values) - Math.min(...values)));
space.fit(...box);
space.render();
const corner = (k) => space.controls.target.clone().set(...[0, 1, 2].map((axis) => box[(k >> axis) & 1][axis]));
const seen = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => corner(k).project(space.camera));
const least = [Math.min(...seen.map(({ x }) => (1 + x) * space.size[0])), Math.min(...seen.map(({ y }) => (1 - y) * space.size[1]))];
return [lost.length, apart3(...box) - length, Math.max(...seen.flatMap(({ x, y }) => [Math.abs(x), Math.abs(y)])),
  Math.max(...least) / 2 - space.side() - 8];
