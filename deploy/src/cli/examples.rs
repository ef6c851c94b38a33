//! Examples at the end of the help texts, by command.

/// What most people type first.
pub(super) const PROGRAM: &str = "\
Examples:
  lodestone play scorpion           Watch the shipped policy build a scorpion
  lodestone train                   Train for a minute, with a page to look at
  lodestone watch                   Watch a training of this machine in the terminal
  lodestone eval --pretrained       Evaluate the shipped policy
  lodestone train --help            What each preset is for and takes";

pub(super) const TRAIN: &str = "\
Examples:
  lodestone train --preset laptop                         Learn all training blueprints
  lodestone train --blueprint scorpion                    Learn one blueprint
  lodestone train --set learner.gamma=0.98                Change a setting
  lodestone train --print-config --explain                Show the settings
  lodestone train --resume runs/NAME --steps 1e6          Continue a run
  lodestone train --preset laptop --init-from pretrained  Start from the shipped policy";

pub(super) const SWEEP: &str = "\
Examples:
  lodestone sweep --grid learner.gamma=0.95,0.97 --seeds 3 --out sweeps/x  Two values, three seeds each
  lodestone sweep sweeps/x                                                 Print the table again
  lodestone serve sweeps/x                                                 Show the curves on a page";

pub(super) const WATCH: &str = "\
Examples:
  lodestone watch                                 The newest training in runs/
  lodestone watch runs/NAME --once --json         Its state now, for a program
  lodestone watch --connect tcp/127.0.0.1:7447    A run on a router";

pub(super) const EVAL: &str = "\
Examples:
  lodestone eval --checkpoint runs/NAME                        A run's best policy
  lodestone eval --pretrained --blueprint scorpion --verbose   The shipped policy on one blueprint
  lodestone eval --pretrained --split test --json              On a split, for a program
  lodestone eval --expert --endings                            The expert, and how it fails";

pub(super) const PLAY: &str = "\
Examples:
  lodestone play                                  The shipped policy, any blueprint
  lodestone play --checkpoint runs/NAME 6_005     What a run learned, on one blueprint
  lodestone play structure.toml                   On a drawing of your own";

pub(super) const SERVE: &str = "\
Examples:
  lodestone serve runs/ONE runs/TWO               Two runs side by side
  lodestone serve runs/NAME --export page         A copy for any web server";

pub(super) const EXPORT: &str = "\
Examples:
  lodestone export --checkpoint runs/NAME --out policy.safetensors    For play, eval, and Python
  lodestone export --checkpoint runs/A --checkpoint runs/B --out mean.safetensors";

pub(super) const REPORT: &str = "\
Examples:
  lodestone report runs/NAME                        Tables in runs/NAME/report
  lodestone report runs/ONE --beside runs/TWO       Two runs in one table";

pub(super) const RECORD: &str = "\
Examples:
  lodestone record --blueprint scorpion --out episodes      Ten episodes of the shipped policy
  lodestone record --expert --split train --out episodes    The expert on all training blueprints";

pub(super) const RENDER: &str = "\
Examples:
  lodestone render runs/NAME --out videos                         All that a run recorded
  lodestone render episodes/*.trajectory --out gifs --format gif  Recorded episodes";

pub(super) const BLUEPRINTS: &str = "\
Examples:
  lodestone blueprints list                            Ids, splits, numbers of blocks, and titles
  lodestone blueprints check structure.toml            Check a drawing of your own
  lodestone blueprints show scorpion --out pictures    Draw one from four sides";

pub(super) const ROUTER: &str = "\
Examples:
  lodestone router --listen tcp/127.0.0.1:7447                    For processes of this machine
  lodestone router --listen quic/0.0.0.0:7447 --keys keys/router  For those of others";

pub(super) const LEARNER: &str = "\
Examples:
  lodestone learner --connect tcp/127.0.0.1:7447 --preset laptop  Join a router
  lodestone learner --listen tcp/127.0.0.1:7447 --preset laptop   Be the router as well";

pub(super) const ACTOR: &str = "\
Examples:
  lodestone actor --connect tcp/127.0.0.1:7447 --preset laptop                Join a run of this machine
  lodestone actor --connect quic/HOST:7447 --keys keys/actor --preset laptop  Join one of another";

pub(super) const EVALUATOR: &str = "\
Examples:
  lodestone evaluator --connect tcp/127.0.0.1:7447 --preset laptop --web 8080  With a page";
