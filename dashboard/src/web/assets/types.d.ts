// Shapes of what the server answers, and of the page's elements, for the type checker only.

/** Numbers along x, y and z. */
export type Vector = number[];

/** Position in meters along x, y and z, then a unit quaternion x, y, z, w. */
export type Pose = number[];

/** Lowest and highest corner, meters. */
export type Box = Vector[];

/** Red, green and blue, 0 to 255. */
export type Rgb = number[];

/** How actions are chosen from the policy's distribution. */
export type Acting = "greedy" | "sampled";

/** Who builds. */
export type Agent = "policy" | "expert";

/** A success rate, 0 to 1, with its 95 % interval. */
export interface Rate {
  n_successes: number;
  n_episodes: number;
  rate: number;
  wilson_low: number;
  wilson_high: number;
}

/** Results of a group of blueprints; `null` where not evaluated. */
export interface Group {
  name: string;
  n_blueprints: number;
  greedy: Rate | null;
  sampled: Rate | null;
}

/** Number of successes and of episodes. */
export type Counts = [number, number];

/** An evaluation. Its counts are in the order of the history's blueprints. */
export interface Evaluation {
  weights_version: number;
  /** Environment steps that the learner had consumed. */
  n_env_steps: number;
  elapsed_s: number;
  groups: Group[];
  all: Group;
  greedy: (Counts | null)[];
  sampled: (Counts | null)[];
}

/** A row of the heat map. */
export interface Row {
  id: string;
  split: string;
  n_blocks: number;
  group: string | null;
}

/** The charted values of one learner update, by their names. */
export interface Point {
  n_env_steps: number;
  elapsed_s: number;
  weights_version: number;
  /** Episodes that ended so far. */
  n_episodes: number;
  [metric: string]: number;
}

/** `/api/history` */
export interface History {
  blueprints: Row[];
  evaluations: Evaluation[];
  n_left_out: number;
  learner: Point[];
}

/** Totals by what happened. */
export type Totals = Record<string, number>;

/** What the mixture head drew of one kind of proposal, each from 0 to 1. */
export interface Draws {
  share?: number;
  success?: number;
}

/** The metrics of the learner. */
export interface Learner {
  weights_version: number;
  n_env_steps: number;
  n_episodes: number;
  elapsed_s: number;
  /** Longer than `elapsed_s` if the run was resumed. */
  run_elapsed_s?: number;
  env_steps_per_s: number;
  policy_lag_mean: number;
  ppo: Record<string, number>;
  /** Those that ended since the last report. */
  episodes: { success: Rate; mean_return: Record<string, number> };
  proposals?: Record<string, any> & { kinds?: Record<string, Draws> };
  ingest?: Totals;
  bus?: Totals;
  expired_total: number;
  unmade_total: number;
  refused_total: number;
  not_saved?: { since_unix_ms: number; reason: string };
}

/** The metrics of an actor. */
export interface Actor {
  weights_version: number;
  env_steps_per_s: number;
  /** Versions between the newest weights and those that act. */
  policy_lag: number;
  dropped: Totals;
  bus: Totals;
}

/** The metrics of an evaluation so far. */
export interface Summary {
  weights_version: number;
  is_complete: boolean;
  /** Episodes of the whole evaluation per action mode. */
  n_planned: number;
  all: Record<Acting, { success: Rate }>;
  bus?: Totals;
  videos?: Totals;
}

/** The names of the processes that are alive. */
export interface Roster {
  actors: string[];
  learners: string[];
  evaluators: string[];
}

/** What produced a run; what is unknown is left out. */
export interface Origin {
  settings: Record<string, any>;
  command?: string[];
  seed?: number;
  commit?: string;
  lodestone_version?: string;
  started_utc?: string;
  resumed_from?: string;
}

/** `/api/about`; `recorded` is only in a static copy. */
export interface About {
  kind: "training" | "play" | "finished";
  run: string;
  preset: string | null;
  /** Environment steps after which the run ends. */
  n_env_steps: number | null;
  blueprints: string[];
  /** The goals that the run trains on; empty if they are not known. */
  trained: string[];
  first: string;
  can_play: boolean;
  gripper_colors: Rgb[];
  runs: { name: string; base: string }[];
  /** Whether the runs are those of a sweep. */
  is_of_sweep: boolean;
  farewell: { ended: string; command: string | null } | null;
  origin: Origin | null;
  /** Successes and episodes of the played policy by number of blocks. */
  success: Record<Acting, Record<string, Counts>> | null;
  recorded?: string[];
}

/** Averages over the seeds and goals of a point, with 95 % intervals where there are several seeds. */
export interface Aggregate {
  mean: number;
  mean_interval: [number, number] | null;
  /** Of the middle half. */
  iqm: number;
  iqm_interval: [number, number] | null;
}

/** The success of a point in a group. */
export interface SweepGroup extends Aggregate {
  group: string;
  acting: Acting;
  n_runs: number;
  n_goals: number;
}

/** A point of a sweep. */
export interface SweepPoint {
  name: string;
  settings: [string, string][];
  /** After all steps. */
  groups: SweepGroup[];
  curve: { n_env_steps: number; groups: SweepGroup[] }[];
  n_done: number;
  failed: { seed: number; status: string; log: string }[];
  /** Seeds of the runs that have not ended. */
  unfinished: number[];
}

/** `/api/sweep` */
export interface SweepResults {
  folder: string;
  seeds: number[];
  points: SweepPoint[];
  /** The runs that are done, in the order of the page's runs. */
  done: { point: number; seed: number }[];
}

/** An entry of `/api/videos`. */
export interface Video {
  id: string;
  blueprint: string;
  weights_version: number;
  ending: string;
}

/** An entry of `/api/blueprints`. */
export interface Blueprint {
  id: string;
  title: string;
  n_blocks: number;
  group: string | null;
}

/** The attention on each block, in percent, by source and scene. */
export interface Attended {
  weights_version: number;
  sources: string[];
  percent: number[][][];
  /**
   * By source and scene, the block that each block attends to most, and the percent; empty for a gripper. The last one
   * is by the mean over the heads of the last layer.
   */
  most: [number, number][][][];
}

/** A moment of an episode. */
export interface Scene {
  blocks: Pose[];
  /** The block in each gripper. */
  held: (number | null)[];
  goal_frame: Pose;
  n_connected: number;
  /** Connected blocks, the lower number first, and whether the goal connects them like this. */
  joints: [number, number, boolean][];
  /** Undiscounted reward so far. */
  reward: number;
  reward_terms: Record<"connected" | "wrong" | "magnets" | "blocks" | "force", number>;
}

/** `/api/replay`, `/api/play` and `/api/recording` */
export interface Episode {
  /** Who builds, if the page knows more than the name of the actor. */
  caption?: string;
  actor: string;
  weights_version: number;
  blueprint: string;
  title: string;
  end: string;
  /** Seconds between two scenes. */
  step_s: number;
  /** Edge of a cell, meters. */
  unit_m: number;
  /** Of the blocks. */
  names: string[];
  half_extents_m: Vector[];
  colors: Rgb[];
  gripper_colors: Rgb[];
  /** The goal's blocks, each with its pose in the goal's frame. */
  goal: [number, Pose][];
  /** The pairs that the goal connects, the lower number first. */
  links: [number, number][];
  scenes: Scene[];
  /** The steps in which somebody outside moved or pushed a block, and the block. */
  disturbances: [number, number][];
  attention: Attended | null;
}

/** A type of block, from `/api/inventory`. */
export interface Kind {
  type: string;
  word: string;
  /** Length along its own axes, cells. */
  cells: Vector;
  count: number;
  color: Rgb;
}

/** A block of a drawing. */
export interface Block {
  type: string;
  /** The lowest-numbered corner cell that it fills. */
  at: Vector;
  /** The directions of its own x and y axes, such as `+x +y`. */
  axes: string;
  /** Whether the server may turn it. */
  is_free: boolean;
}

/** `/api/check` */
export interface Findings {
  title?: string;
  blocks?: Block[];
  problems: { check: string; blocks: number[]; text: string }[];
  connections: { a: number; b: number; n_magnet_pairs: number }[];
  /** The blueprint file, if the drawing can be built. */
  toml: string | null;
}

/** A place for a block: its lowest corner and its size in cells. */
export interface Spot {
  at: Vector;
  size: Vector;
  color: Rgb;
}

/** A block as drawn on the grid. */
export interface Drawn extends Spot {
  type: string;
  /** Length along its own axes, cells. */
  cells: Vector;
  pose: Pose;
}

/** What is under the pointer: `cell` is the empty cell beside it, toward `normal`; `block` is `null` on the grid. */
export interface Hit {
  /** Distance along the ray. */
  t: number;
  block: number | null;
  cell: Vector;
  normal: Vector;
}

/** The ids in page.html of elements with more properties than others. */
interface Elements {
  "beside": HTMLCanvasElement;
  "chart-axis": HTMLSelectElement;
  "chart-log-x": HTMLInputElement;
  "chart-log-y": HTMLInputElement;
  "chart-smoothing": HTMLInputElement;
  "chart-whole": HTMLButtonElement;
  "draw-canvas": HTMLCanvasElement;
  "draw-copy": HTMLButtonElement;
  "draw-expert": HTMLButtonElement;
  "draw-file": HTMLInputElement;
  "draw-layer": HTMLInputElement;
  "draw-match": HTMLButtonElement;
  "draw-name": HTMLInputElement;
  "draw-policy": HTMLButtonElement;
  "draw-save": HTMLButtonElement;
  "drops": HTMLTableElement;
  "gallery": HTMLDialogElement;
  "groups": HTMLTableElement;
  "hand-block": HTMLSelectElement;
  "hand-undo": HTMLButtonElement;
  "heat": HTMLCanvasElement;
  "heat-find": HTMLInputElement;
  "heat-whole": HTMLInputElement;
  "heat-scale": HTMLCanvasElement;
  "replay": HTMLCanvasElement;
  "replay-ask": HTMLButtonElement;
  "replay-eye": HTMLSelectElement;
  "replay-ghost": HTMLInputElement;
  "replay-more": HTMLDetailsElement;
  "replay-slider": HTMLInputElement;
  "replay-speed": HTMLSelectElement;
  "roster": HTMLTableElement;
  "snapshot": HTMLInputElement;
  "snapshot-beside": HTMLInputElement;
  "snapshot-other": HTMLInputElement;
  "stage-both": HTMLInputElement;
  "stage-keep": HTMLInputElement;
  "stage-onward": HTMLInputElement;
}

/** The element with this id. */
export type ById<Id extends string> = Id extends keyof Elements ? Elements[Id] : HTMLElement;
