//! What all trainings have in common: how long, how fast, and going on after an interruption.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use veiloc_evaluation::inversion::{Course, Progress, TrainingState};

use crate::exit::Failure;
use crate::files;
use crate::localization_args::positive;
use crate::ui::Ui;

/// Arguments of every training.
#[derive(clap::Args)]
pub(super) struct CourseArgs {
    /// The network's file. FILE.state beside it holds the training until all its steps are done.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Go on with the training that FILE.state holds, with the same options and images, as if it had not been
    /// interrupted; without such a file, begin.
    #[arg(long)]
    resume: bool,
    /// Stop after so many minutes, to go on later. The network is then that of the best look so far. Default:
    /// no limit.
    #[arg(long, value_name = "N", conflicts_with = "hours", value_parser = positive)]
    minutes: Option<f64>,
    /// The same in hours. Default: no limit.
    #[arg(long, value_name = "N", value_parser = positive)]
    hours: Option<f64>,
    /// Steps of the optimizer.
    #[arg(long, default_value_t = 3000, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Steps from one look at the validation images to the next.
    #[arg(long, default_value_t = 250, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Images of a step; they are worked on side by side.
    #[arg(long, default_value_t = 2, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    images: u32,
    /// Highest learning rate.
    #[arg(long, default_value_t = 1e-3, value_name = "RATE")]
    rate: f64,
    /// Decay of weights.
    #[arg(long, default_value_t = 0.01, value_name = "DECAY")]
    decay: f64,
    /// Seed of weights and draws; equal seeds give equal networks.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Draw loss and validation figures by step into FILE, as SVG.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// Least time between two writings of a training's state.
const WRITE_EVERY: Duration = Duration::from_secs(60);

impl CourseArgs {
    /// What the loop of a training needs.
    pub(super) fn course(&self) -> Course {
        Course {
            steps: self.steps as usize,
            images: self.images as usize,
            learning_rate: self.rate,
            weight_decay: self.decay,
            validate_every: self.every as usize,
            seed: self.seed,
        }
    }

    fn state_file(&self) -> PathBuf {
        let mut name = self.out.clone().into_os_string();
        name.push(".state");
        name.into()
    }

    /// The training that goes on, where one does.
    pub(super) fn earlier(&self, ui: &Ui) -> Result<Option<TrainingState>, Failure> {
        let path = self.state_file();
        if !self.resume || !path.exists() {
            return Ok(None);
        }
        let state = TrainingState::decode(&files::read(&path)?)
            .map_err(|e| Failure::refused(format!("{}: {e}", path.display())))?;
        ui.say(format!("going on behind step {}", state.step()));
        Ok(Some(state))
    }

    /// Trains with a bar, a limit of time, and the state written beside now and then.
    pub(super) fn watched<T>(
        &self,
        ui: &Ui,
        words: impl Fn(f64) -> String,
        train: impl FnOnce(&mut dyn FnMut(Progress<'_>) -> ControlFlow<()>) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let total = u64::from(self.steps);
        let stage = ui.stage("Training", total);
        let minutes = self.minutes.or(self.hours.map(|h| 60.0 * h));
        let limit = minutes.and_then(|m| Duration::try_from_secs_f64(60.0 * m).ok());
        let mut watch = Watch {
            path: self.state_file(),
            began: Instant::now(),
            limit,
            written: Instant::now(),
            fault: None,
        };
        let trained = train(&mut |progress| {
            stage.reach(progress.step as u64, total);
            if let Some(p) = progress.point {
                stage.suspend(|| {
                    ui.say(format!("step {}: loss {:.4}, {}", p.step, p.loss, words(p.judged)));
                });
            }
            watch.look(&progress)
        });
        if let Some(fault) = watch.fault {
            return Err(fault);
        }
        stage.finish();
        trained
    }

    /// Writes the network, and the state until all steps are done.
    pub(super) fn write(&self, network: &[u8], state: &TrainingState, ui: &Ui) -> Result<(), Failure> {
        files::write(&self.out, network)?;
        let path = self.state_file();
        if state.step() < self.steps as usize {
            files::write(&path, &state.encode())?;
            ui.say(format!(
                "{} of {} steps are done; --resume goes on with {}",
                state.step(),
                self.steps,
                path.display()
            ));
        } else if path.exists() {
            remove(&path)?;
        }
        Ok(())
    }

    pub(super) fn plot(&self) -> Option<&Path> {
        self.plot.as_deref()
    }
}

fn remove(path: &Path) -> Result<(), Failure> {
    std::fs::remove_file(path).map_err(|e| Failure::output(path.display(), &e))
}

/// Keeps an eye on the clock.
struct Watch {
    path: PathBuf,
    began: Instant,
    limit: Option<Duration>,
    written: Instant,
    fault: Option<Failure>,
}

impl Watch {
    fn look(&mut self, progress: &Progress<'_>) -> ControlFlow<()> {
        if self.written.elapsed() > WRITE_EVERY {
            self.written = Instant::now();
            if let Err(fault) = files::write(&self.path, &progress.state.encode()) {
                self.fault = Some(fault);
                return ControlFlow::Break(());
            }
        }
        let over = self.limit.is_some_and(|limit| self.began.elapsed() > limit);
        if over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
