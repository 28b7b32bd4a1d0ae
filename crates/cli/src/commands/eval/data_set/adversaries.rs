//! `--attack N` of the data-set commands: what each adversary recovers from the queries of each scene.

use veiloc_evaluation::SceneEvaluation;
use veiloc_evaluation::attack_evaluation::AttackEvaluation;
use veiloc_evaluation::attack_evaluation::adversaries::{
    AdversariesDocument, AdversariesEvaluation, adversaries_table, evaluate_adversaries,
};

use crate::output::exit::Failure;
use crate::output::files;
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Attacks on the queries of the scenes.
#[derive(clap::Args)]
pub(in crate::commands::eval) struct AttackArgs {
    /// Also attack N queries of each scene, evenly spaced, as `eval adversaries` does without training data: a server
    /// with map images, a server that knows the pose, several frames, and the oracle. This builds another map. Default:
    /// no attack.
    #[arg(id = "attack", long = "attack", value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    attacked: Option<u32>,
    /// Neighbours per keypoint in these attacks; the paper uses 20 and 100.
    #[arg(long, value_name = "K", default_value_t = 20, requires = "attack", value_parser = clap::value_parser!(u32).range(1..=1000))]
    attack_neighbours: u32,
    /// Write the attack results as in `eval adversaries --json`, with the names of the scenes. Default: only a table.
    #[arg(long, value_name = "FILE", requires = "attack")]
    attack_json: Option<OutFile>,
}

impl AttackArgs {
    /// Attacks the queries of a scene if requested, and adds the result to the others.
    pub(super) fn attack(
        &self,
        name: &str,
        scene: &SceneEvaluation,
        found: &mut Option<AdversariesDocument>,
        ui: &Ui,
    ) -> Result<(), Failure> {
        let Some(attacked) = self.attacked else { return Ok(()) };
        if !scene.schemes.iter().any(|scheme| scheme.hides_positions()) || scene.query_list.is_empty() {
            ui.warn(format!(
                "{name}: nothing to attack: no scheme hides positions, or no query has a known pose"
            ));
            return Ok(());
        }
        let evaluation = AdversariesEvaluation {
            scene: Some(scene.clone()),
            attack: AttackEvaluation {
                schemes: scene.schemes.clone(),
                k: self.attack_neighbours as usize,
                seed: scene.seed,
                ..AttackEvaluation::default()
            },
            attacked: Some(attacked as usize),
            ..AdversariesEvaluation::default()
        };
        let mut of_scene = evaluate_adversaries(&evaluation, &Stages::new(ui))?;
        for row in &mut of_scene.rows {
            name.clone_into(&mut row.data);
        }
        match found {
            Some(all) => all.rows.append(&mut of_scene.rows),
            None => *found = Some(of_scene),
        }
        Ok(())
    }

    /// Prints the results of all scenes, and writes the document if requested.
    pub(super) fn finish(
        &self,
        found: Option<&AdversariesDocument>,
        stdout_is_taken: bool,
        ui: &Ui,
    ) -> Result<(), Failure> {
        let Some(document) = found else { return Ok(()) };
        let table = adversaries_table(document);
        if stdout_is_taken {
            ui.info(table.trim_end());
        } else {
            ui.print(format!("\n{table}"));
        }
        if let Some(path) = &self.attack_json {
            files::write(path, (serde_json::to_string_pretty(document)? + "\n").as_bytes())?;
        }
        Ok(())
    }
}
