//! Progressive queries: a few rows first, more only until the service trusts the pose (decision 0020).

use veiloc_protocol::{Answer, Profile, SealedQuery, StopCriterion};

use crate::{Client, ClientError, LocalizeRequest};

/// One step of a progressive query.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Step {
    /// Rows of the message, including those of earlier steps.
    pub rows: usize,
    /// Bytes of the message.
    pub bytes: usize,
    /// The result of the step.
    pub outcome: StepOutcome,
}

/// The result of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepOutcome {
    /// A trusted pose.
    Trusted,
    /// A doubtful pose.
    Doubtful,
    /// No pose.
    NotLocalized,
}

impl StepOutcome {
    /// The name in text form.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
            Self::NotLocalized => "not-found",
        }
    }
}

/// The answer to a progressive query, with its steps.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ProgressiveAnswer {
    /// The answer to the last step.
    pub answer: Answer,
    /// The steps that were sent, in order.
    pub steps: Vec<Step>,
}

impl ProgressiveAnswer {
    /// Rows that the service has received: those of the last step, which contains all others.
    pub fn rows(&self) -> usize {
        self.steps.last().map_or(0, |step| step.rows)
    }

    /// Total bytes of all messages.
    pub fn bytes(&self) -> usize {
        self.steps.iter().map(|step| step.bytes).sum()
    }
}

impl Client {
    /// The pose of a sealed query, sending only as many rows as needed: the first 256 rows, then twice as many, and so
    /// on, until a pose is `criterion` or all rows are sent. Rows are in random order, and a step sends a prefix of the
    /// one sealed query, including the rows of earlier steps: the service needs no state, and all steps together reveal
    /// what the whole query would reveal (rule L7). After an error the call may be repeated with the same query.
    ///
    /// A step with too few rows on one side of the dividing line is skipped. `profile` is the one the query was sealed
    /// with. The answer is that of the last step, also if an earlier step was trusted but not accurate enough.
    ///
    /// This does not protect against a malicious service: one that trusts no pose receives all rows.
    ///
    /// # Errors
    /// As [`Self::localize_with`], of the last step; [`ClientError::ProfileMismatch`] when the query was not sealed
    /// with the profile; then nothing is sent.
    pub fn localize_progressive(
        &self,
        map: &str,
        query: &SealedQuery,
        profile: &Profile,
        criterion: StopCriterion,
        request: &LocalizeRequest,
    ) -> Result<ProgressiveAnswer, ClientError> {
        // A query that cannot determine a pose as a whole is not sent at all.
        query.check_sides()?;
        profile.check(query).map_err(ClientError::ProfileMismatch)?;
        let mut steps = Vec::new();
        let mut last = None;
        for class in query.step_sizes() {
            let part = query.first_rows(class, profile).map_err(ClientError::ProfileMismatch)?;
            if part.check_sides().is_err() {
                continue;
            }
            let result = match self.localize_with(map, &part, request) {
                Err(error) if !matches!(error, ClientError::NotLocalized(_)) => return Err(error),
                result => result,
            };
            let outcome = match &result {
                Ok(answer) if answer.trusted() => StepOutcome::Trusted,
                Ok(_) => StepOutcome::Doubtful,
                Err(_) => StepOutcome::NotLocalized,
            };
            steps.push(Step { rows: part.len(), bytes: part.encode().len(), outcome });
            let is_enough =
                result.as_ref().is_ok_and(|answer| criterion.is_met(answer.trusted(), answer.position_sd()));
            last = Some(result);
            if is_enough {
                break;
            }
        }
        let answer = last.expect("the last step is the whole query, whose sides were checked")?;
        Ok(ProgressiveAnswer { answer, steps })
    }
}
