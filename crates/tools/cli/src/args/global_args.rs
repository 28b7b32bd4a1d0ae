//! Which global descriptors, and the consent to send one that is made of the image.

use veiloc_features::SharedGlobal;
use veiloc_features::learned::Models;
use veiloc_obfuscation::SealOptions;
use veiloc_protocol::Profile;

use crate::exit::Failure;
use crate::ui::Ui;

/// The name of global descriptors that are summed up from the rows that are sent.
pub(crate) const VLAD: &str = "vlad";

/// What makes global descriptors of this name, or of the description file that it is; `None` for `vlad`.
///
/// # Errors
/// An unknown model, no file for it, or one that cannot be used.
pub(crate) fn global_named(models: &Models, name: &str) -> Result<Option<SharedGlobal>, Failure> {
    if name == VLAD {
        return Ok(None);
    }
    Ok(Some(SharedGlobal::new(models.open_global(name)?)))
}

/// What makes the global descriptors that a map asks for.
#[derive(clap::Args)]
pub(crate) struct MapGlobalArgs {
    /// What makes the global descriptors, where the map's are made of whole images: the name of a model (`veiloc models`), or a
    /// .toml file that describes one. Default: the one of the name that the map asks for.
    #[arg(long, value_name = "MODEL|FILE")]
    global: Option<String>,
}

impl MapGlobalArgs {
    /// The map's own of these models, or nothing where its global descriptors are summed up from rows.
    ///
    /// # Errors
    /// An unknown model, no file for it, one that cannot be used, or another than the map's.
    pub(crate) fn extractor(
        &self,
        models: &Models,
        profile: &Profile,
    ) -> Result<Option<SharedGlobal>, Failure> {
        let asked = profile.global_model().name();
        let own = global_named(models, self.global.as_deref().unwrap_or(asked))?;
        fits(profile, own.as_ref())?;
        Ok(own)
    }
}

/// The consent to a global descriptor that is made of the image.
#[derive(clap::Args)]
pub(crate) struct ConsentArgs {
    /// Consent to send the global descriptor of this model, made of the image, where the map asks for it: a name (`veiloc models`),
    /// or a .toml file that describes it. It tells more than the rows do (docs/reference/privacy-rules.md, rule L14). Default: no consent, and
    /// maps that ask for one are refused.
    #[arg(long, value_name = "MODEL|FILE")]
    image_global: Option<String>,
}

impl ConsentArgs {
    /// The options with the owner's consent, where it was given and the map asks. Says what is sent beyond rows.
    ///
    /// # Errors
    /// A map that asks for what was not consented to; a model that cannot be used.
    pub(crate) fn consented(
        &self,
        options: SealOptions,
        models: &Models,
        profile: &Profile,
        ui: &Ui,
    ) -> Result<SealOptions, Failure> {
        let (asked, of_rows) = (profile.global_model().name(), profile.vocabulary().is_some());
        match &self.image_global {
            None => {
                options.image_global(profile).map_err(|refused| {
                    let help = format!(
                        "to send it all the same give --image-global {asked}, after docs/reference/privacy-rules.md, rule L14; or ask for a map \
                         without one"
                    );
                    Failure::with_help(refused, help)
                })?;
                Ok(options)
            }
            Some(_) if of_rows => {
                ui.say("the map asks for no global descriptor of the image; none is sent");
                Ok(options)
            }
            Some(name) => {
                let own = global_named(models, name)?;
                fits(profile, own.as_ref())?;
                ui.complain(format!(
                    "the global descriptor {asked} is made of the image and sent: it tells more of it than the rows do"
                ));
                Ok(own.map_or(options.clone(), |own| options.with_image_global(own)))
            }
        }
    }
}

fn fits(profile: &Profile, own: Option<&SharedGlobal>) -> Result<(), Failure> {
    let asked = profile.global_model();
    let (name, codes) =
        own.map_or((VLAD.to_owned(), None), |own| (own.model().name().to_owned(), Some(own.model().dim())));
    if name == asked.name() && codes.is_none_or(|codes| codes == asked.global_len()) {
        return Ok(());
    }
    let numbers = codes.map_or_else(String::new, |codes| format!(" ({codes} numbers)"));
    Err(Failure::with_help(
        format!(
            "the map's global descriptors are {} ({} numbers), and {name}{numbers} is given: they never match",
            asked.name(),
            asked.global_len()
        ),
        "give the model the map was built with",
    ))
}
