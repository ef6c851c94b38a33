//! Progress of an evaluation's episodes.

use std::time::{Duration, Instant};

use evaluator::report::{End, EpisodeResult};
use parking_lot::Mutex;

use super::lines::left;
use super::terminal::Progress;
use super::{LINE_PERIOD, Terminal};

/// Counts episodes and shows the count, as a progress bar or as a line every ten seconds.
#[derive(Debug)]
pub struct EpisodeCounter {
    terminal: Terminal,
    progress: Progress,
    n_planned: u64,
    start: Instant,
    counts: Mutex<Counts>,
}

#[derive(Debug)]
struct Counts {
    n_ended: u64,
    n_successes: u64,
    last_line: Instant,
}

impl EpisodeCounter {
    /// Creates a counter that shows on `terminal` how many of `n_planned` episodes have ended.
    pub fn new(terminal: Terminal, n_planned: u64) -> Self {
        let progress = terminal.progress(n_planned, "episodes");
        let start = Instant::now();
        let counts = Mutex::new(Counts { n_ended: 0, n_successes: 0, last_line: start });
        Self { terminal, progress, n_planned, start, counts }
    }

    /// Counts an episode that has ended.
    pub fn count(&self, episode: &EpisodeResult) {
        let mut counts = self.counts.lock();
        counts.n_ended += 1;
        counts.n_successes += u64::from(matches!(episode.end, End::Success { .. }));
        let text = text(counts.n_ended, counts.n_successes, self.n_planned, self.start.elapsed());
        self.progress.set(counts.n_ended, &text);
        if !self.progress.is_drawn() && counts.last_line.elapsed() >= LINE_PERIOD {
            counts.last_line = Instant::now();
            self.terminal.print(&format!("{} of {} episodes  {text}", counts.n_ended, self.n_planned));
        }
    }

    /// Removes the progress bar; returns how many episodes have ended.
    pub fn finish(&self) -> u64 {
        self.progress.finish();
        self.counts.lock().n_ended
    }
}

/// Success rate so far, and the time left at this pace.
fn text(n_ended: u64, n_successes: u64, n_planned: u64, elapsed: Duration) -> String {
    let percent = 100.0 * n_successes as f64 / n_ended.max(1) as f64;
    format!("success {percent:.1} %  {}", left(n_ended, n_planned, elapsed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn success_and_rest_are_those_of_the_episodes_so_far() {
        // 20 episodes in 10 s, with 100 left.
        assert_eq!(text(20, 5, 120, Duration::from_secs(10)), "success 25.0 %  50 s left");
        assert_eq!(text(0, 0, 120, Duration::ZERO), "success 0.0 %  0 s left");
    }
}
