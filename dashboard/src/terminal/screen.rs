//! The terminal: setup, restore, key events, and redraw timing.

use std::io::{self, Stdout, stdout};
use std::mem::ManuallyDrop;
use std::panic;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use bus::BusConfig;
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{self, Event};
use ratatui::crossterm::terminal::{EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode};
use ratatui::crossterm::{cursor, execute};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use super::view::{self, Controls};
use crate::run_view::RunView;

/// Redraw period. Ages are shown in seconds.
const TICK: Duration = Duration::from_secs(1);

/// Shortest time between two redraws caused by metrics.
const FRAME: Duration = Duration::from_millis(50);

/// How often the key-reading thread checks for cancellation.
const KEYS_PERIOD: Duration = Duration::from_millis(100);

/// The terminal in raw mode on its alternate screen, until dropped or until the program panics.
struct Screen {
    /// Never dropped: it would show the cursor, which `give_back` does, and panic if the terminal is gone.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
    is_taken: Arc<AtomicBool>,
}

/// Draws the run as it changes until the user quits, `shutdown` is cancelled, or the task that follows the bus ends.
///
/// # Errors
/// Returns an error if the terminal cannot be set up, read from or drawn to. The terminal is restored in any case.
pub(super) async fn show(
    mut run: watch::Receiver<RunView>,
    config: &BusConfig,
    start: Instant,
    shutdown: &CancellationToken,
) -> io::Result<()> {
    let mut screen = Screen::take(shutdown.clone())?;
    let (keys, mut events) = mpsc::channel(16);
    let end = shutdown.child_token();
    let _end_of_keys = end.clone().drop_guard();
    // A separate thread, because waiting for keys blocks. It is not joined: it ends within `KEYS_PERIOD`.
    std::thread::Builder::new().name("keys".to_owned()).spawn(move || read_events(&keys, &end))?;
    let mut controls = Controls::default();
    loop {
        screen.terminal.draw(|frame| {
            view::draw(frame, &run.borrow_and_update(), config, &mut controls, start.elapsed());
        })?;
        let changed = async {
            tokio::time::sleep(FRAME).await;
            run.changed().await
        };
        tokio::select! {
            () = shutdown.cancelled() => return Ok(()),
            event = events.recv() => match event {
                Some(Ok(Event::Key(key))) => if controls.press(key) {
                    return Ok(());
                },
                // A resize only requires a redraw.
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(error),
                None => return Ok(()),
            },
            is_open = changed => if is_open.is_err() {
                return Ok(());
            },
            () = tokio::time::sleep(TICK) => {}
        }
    }
}

impl Screen {
    /// Sets up the terminal. A panic on any thread restores it before printing its message, and cancels `shutdown`.
    fn take(shutdown: CancellationToken) -> io::Result<Self> {
        let is_taken = Arc::new(AtomicBool::new(true));
        let before = panic::take_hook();
        let was_taken = is_taken.clone();
        panic::set_hook(Box::new(move |panic| {
            give_back(&was_taken);
            shutdown.cancel();
            before(panic);
        }));
        // From here on, dropping `screen` restores the terminal even if the setup fails halfway.
        let terminal = ManuallyDrop::new(Terminal::new(CrosstermBackend::new(stdout()))?);
        let mut screen = Self { terminal, is_taken };
        enable_raw_mode()?;
        execute!(stdout(), EnterAlternateScreen, cursor::Hide)?;
        screen.terminal.clear()?;
        Ok(screen)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        give_back(&self.is_taken);
    }
}

/// Restores the terminal, once.
fn give_back(is_taken: &AtomicBool) {
    if is_taken.swap(false, Ordering::SeqCst) {
        // Try both: if one fails, the other may still succeed.
        let shown = execute!(stdout(), LeaveAlternateScreen, cursor::Show);
        if let Err(error) = disable_raw_mode().and(shown) {
            tracing::debug!(%error, "the terminal is gone");
        }
    }
}

fn read_events(events: &mpsc::Sender<io::Result<Event>>, end: &CancellationToken) {
    while !end.is_cancelled() {
        let event = match event::poll(KEYS_PERIOD) {
            Ok(false) => continue,
            Ok(true) => event::read(),
            Err(error) => Err(error),
        };
        let is_last = match &event {
            // Stop before reading keys meant for the shell.
            Ok(Event::Key(key)) => view::ends(*key),
            Ok(_) => false,
            Err(_) => true,
        };
        if events.blocking_send(event).is_err() || is_last {
            return;
        }
    }
}
