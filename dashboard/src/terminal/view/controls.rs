//! The state of the interactive controls: selected part, row order, scroll position; and the key bindings.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::text::Line;

use super::styled::{columns, heading, plain};

/// Lines of the previous page that stay visible after paging.
const KEPT_LINES: usize = 1;

/// A part of the view; the screen shows one at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Part {
    /// Summary of the whole run.
    #[default]
    Overview,
    /// All evaluated blueprints.
    Blueprints,
    /// All actors.
    Actors,
    /// Metrics over time.
    Learning,
}

/// A row order: by one of the columns in [`Part::orders`], optionally reversed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Order {
    /// Index of the column.
    pub(super) by: usize,
    pub(super) is_reversed: bool,
}

/// The current state of the controls.
#[derive(Clone, Debug, Default)]
pub(crate) struct Controls {
    part: Part,
    orders: [Order; Part::ALL.len()],
    /// Number of lines scrolled past, clamped to the available lines by [`Self::visible`].
    scroll: usize,
    /// Number of lines per page at the last redraw.
    n_page: usize,
    is_helping: bool,
}

impl Part {
    const ALL: [Self; 4] = [Self::Overview, Self::Blueprints, Self::Actors, Self::Learning];

    fn name(self) -> &'static str {
        match self {
            Self::Overview => "overview",
            Self::Blueprints => "blueprints",
            Self::Actors => "actors",
            Self::Learning => "learning",
        }
    }

    /// Returns the columns that its rows can be sorted by.
    fn orders(self) -> &'static [&'static str] {
        match self {
            Self::Overview | Self::Learning => &[],
            Self::Blueprints => &["success", "blueprint", "blocks"],
            Self::Actors => &["name", "steps/s", "lag", "dropped"],
        }
    }
}

impl Controls {
    /// Handles a key press. Returns whether to quit.
    pub(crate) fn press(&mut self, key: KeyEvent) -> bool {
        if key.kind == KeyEventKind::Release {
            return false;
        }
        if ends(key) {
            return true;
        }
        let order = &mut self.orders[self.part as usize];
        let n_turned = self.n_page.saturating_sub(KEPT_LINES).max(1);
        match key.code {
            KeyCode::Esc if self.is_helping => self.is_helping = false,
            KeyCode::Esc if self.part != Part::Overview => self.choose(Part::Overview),
            KeyCode::Esc => return true,
            KeyCode::Char('?' | 'h') => {
                self.is_helping = !self.is_helping;
                self.scroll = 0;
            }
            KeyCode::Char(digit @ '1'..='4') => self.choose(Part::ALL[digit as usize - '1' as usize]),
            KeyCode::Tab | KeyCode::Right => self.choose(self.part_after(1)),
            KeyCode::BackTab | KeyCode::Left => self.choose(self.part_after(Part::ALL.len() - 1)),
            KeyCode::Char('s') => order.by = (order.by + 1) % self.part.orders().len().max(1),
            KeyCode::Char('r') => order.is_reversed = !order.is_reversed,
            KeyCode::Down | KeyCode::Char('j') => self.scroll += 1,
            KeyCode::Up | KeyCode::Char('k') => self.scroll = self.scroll.saturating_sub(1),
            KeyCode::PageDown | KeyCode::Char(' ') => self.scroll += n_turned,
            KeyCode::PageUp => self.scroll = self.scroll.saturating_sub(n_turned),
            KeyCode::Home | KeyCode::Char('g') => self.scroll = 0,
            // To the last page; the next redraw clamps the value.
            KeyCode::End | KeyCode::Char('G') => self.scroll = usize::MAX / 2,
            _ => {}
        }
        false
    }

    fn choose(&mut self, part: Part) {
        (self.part, self.scroll, self.is_helping) = (part, 0, false);
    }

    fn part_after(&self, n: usize) -> Part {
        Part::ALL[(self.part as usize + n) % Part::ALL.len()]
    }

    /// Returns the part on the screen, or `None` while the help is shown.
    pub(super) fn part(&self) -> Option<Part> {
        (!self.is_helping).then_some(self.part)
    }

    /// Returns the row order of the part on the screen.
    pub(super) fn order(&self) -> Order {
        self.orders[self.part as usize]
    }

    /// Returns the part of `lines` that fits on a page of `n_page` lines at the current scroll position.
    pub(super) fn visible(&mut self, lines: Vec<Line<'static>>, n_page: usize) -> Vec<Line<'static>> {
        self.n_page = n_page;
        self.scroll = self.scroll.min(lines.len().saturating_sub(n_page));
        lines.into_iter().skip(self.scroll).take(n_page).collect()
    }

    /// Returns the bottom line of the screen: the parts to choose from, and which of `n_lines` are visible.
    pub(super) fn footer(&self, n_lines: usize) -> Line<'static> {
        let parts = Part::ALL.map(|part| match self.part() == Some(part) {
            true => format!("[{}]", part.name()),
            false => part.name().to_owned(),
        });
        let mut text = format!("{}  ? help", parts.join(" "));
        if let Some(by) = self.part().and_then(|part| part.orders().get(self.order().by)) {
            text += &format!("  by {by}{}", if self.order().is_reversed { " ↑" } else { "" });
        }
        if n_lines > self.n_page {
            text += &format!("  {} to {} of {n_lines}", self.scroll + 1, (self.scroll + self.n_page).min(n_lines));
        }
        columns(text)
    }
}

/// Returns whether a key quits from any part of the view.
pub(crate) fn ends(key: KeyEvent) -> bool {
    let with_control = key.modifiers.contains(KeyModifiers::CONTROL);
    key.kind != KeyEventKind::Release
        && match key.code {
            KeyCode::Char('q' | 'Q') => !with_control,
            // Raw mode delivers Ctrl-C as a key instead of a signal.
            KeyCode::Char('c') => with_control,
            _ => false,
        }
}

/// Returns the key bindings and a glossary.
pub(super) fn help() -> Vec<Line<'static>> {
    let keys = [
        ("1 2 3 4, Tab, ← →", "overview, blueprints, actors, learning"),
        ("↑ ↓, PgUp PgDn, Home End", "scroll; j k g G do so too"),
        ("s", "sort blueprints or actors by something else"),
        ("r", "turn their order around"),
        ("? or h", "this help, and back"),
        ("Esc", "back, and from the overview to the end"),
        ("q, Ctrl-C", "end the watch; the run goes on"),
    ];
    let words = [
        ("greedy, sampled", "ways of acting in an evaluation"),
        ("of", "episodes behind a rate, with its 95 % interval"),
        ("lag", "versions from the weights that act to the newest"),
        ("KL, entropy, clipped", "of an update of PPO, in nats; the share of samples"),
        ("draws, succeeded", "the mixture head's, by kind; those done in one step"),
        ("entropy 1 / 2 / 3", "of 1st proposal, 2nd gripper's block, 2nd proposal"),
        ("back-pressure", "segments that waited because the learner had enough"),
    ];
    let row = |(name, meaning): (&str, &str)| plain(format!("  {name:<26}{meaning}"));
    let keys = [heading("Keys".to_owned())].into_iter().chain(keys.map(row));
    let words = [heading("Words".to_owned())].into_iter().chain(words.map(row));
    keys.chain(words).collect()
}
