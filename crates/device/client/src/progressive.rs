//! Progressive queries: a few rows first, more only while the service does not trust the pose (decision 0020).

use veiloc_protocol::{Answer, Enough, Profile, SealedQuery};

use crate::{Client, ClientError, LocalizeRequest};

/// One step of a progressive query, as it was sent.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Step {
    /// Rows of the message, those of the steps before included.
    pub rows: usize,
    /// Bytes of the message.
    pub bytes: usize,
    /// What became of it.
    pub outcome: StepOutcome,
}

/// What became of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepOutcome {
    /// A trusted pose.
    Trusted,
    /// A doubtful one.
    Doubtful,
    /// No pose.
    NotLocalized,
}

impl StepOutcome {
    /// As it is written.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
            Self::NotLocalized => "not-found",
        }
    }
}

/// The answer to a progressive query, and what it took.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ProgressiveAnswer {
    /// The answer to the last step.
    pub answer: Answer,
    /// What was sent, in order.
    pub steps: Vec<Step>,
}

impl ProgressiveAnswer {
    /// Rows that the service has seen: those of the last step, which hold all others.
    pub fn rows(&self) -> usize {
        self.steps.last().map_or(0, |step| step.rows)
    }

    /// Bytes of all messages together.
    pub fn bytes(&self) -> usize {
        self.steps.iter().map(|step| step.bytes).sum()
    }
}

impl Client {
    /// The pose of a sealed query, of which no more is sent than that takes: its first 256 rows, then twice as many, and so
    /// on, until a pose is `enough` or all rows are sent. Rows stand in a random order, and what a step sends is the
    /// beginning of the one sealed query, with the rows of the steps before: the service need keep nothing, and all steps
    /// together tell it what the whole query would have told (rule L7). After an error the call may be made again with the
    /// same query.
    ///
    /// A step with too few rows on one side of the dividing line is left out. `profile` is the one it was sealed with. The
    /// answer is that of the last step, also where one before it was trusted and not exact enough.
    ///
    /// It shows a service that wants it no less than the whole query does: one that trusts no pose gets all rows.
    ///
    /// # Errors
    /// As [`Self::localize_with`], of the last step; [`ClientError::NotOfProfile`] when the query was not sealed with the
    /// profile, and nothing was sent.
    pub fn localize_progressive(
        &self,
        map: &str,
        query: &SealedQuery,
        profile: &Profile,
        enough: Enough,
        request: &LocalizeRequest,
    ) -> Result<ProgressiveAnswer, ClientError> {
        // What could not fix a pose when it is whole is not begun.
        query.check_sides()?;
        profile.check(query).map_err(ClientError::NotOfProfile)?;
        let mut steps = Vec::new();
        let mut last = None;
        for class in query.step_sizes() {
            let part = query.first_rows(class, profile).map_err(ClientError::NotOfProfile)?;
            if part.check_sides().is_err() {
                continue;
            }
            let result = match self.localize_with(map, &part, request) {
                Err(error) if !matches!(error, ClientError::NotLocalized(_)) => return Err(error),
                result => result,
            };
            let outcome = match &result {
                Ok(answer) if answer.trusted => StepOutcome::Trusted,
                Ok(_) => StepOutcome::Doubtful,
                Err(_) => StepOutcome::NotLocalized,
            };
            steps.push(Step { rows: part.len(), bytes: part.encode().len(), outcome });
            let is_enough = result.as_ref().is_ok_and(|answer| {
                let sd = answer.pose.as_ref().map_or(f64::INFINITY, |pose| pose.position_sd());
                enough.is_met(answer.trusted, sd)
            });
            last = Some(result);
            if is_enough {
                break;
            }
        }
        let answer = last.expect("the last step is the whole query, whose sides were checked")?;
        Ok(ProgressiveAnswer { answer, steps })
    }
}
