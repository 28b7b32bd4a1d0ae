//! Selection of global descriptors, and the consent to send one that is computed from the whole image.

use veiloc_features::SharedGlobal;
use veiloc_features::learned::Models;
use veiloc_obfuscation::{SealError, SealOptions, Sealer};
use veiloc_protocol::Profile;

use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// Name of the global descriptor that is aggregated from the local descriptors of a query.
pub(crate) const VLAD: &str = "vlad";

/// Returns the extractor of the global descriptor with this name or description file; `None` for `vlad`.
///
/// # Errors
/// The model is unknown, has no file, or cannot be used.
pub(crate) fn global_extractor(models: &Models, name: &str) -> Result<Option<SharedGlobal>, Failure> {
    if name == VLAD {
        return Ok(None);
    }
    Ok(Some(SharedGlobal::new(models.open_global(name)?)))
}

/// Global descriptors for a map that already names its model.
#[derive(clap::Args)]
pub(crate) struct MapGlobalArgs {
    /// Model of the global descriptor, for a map whose global descriptors are computed from whole images: the name of a
    /// model (`veiloc models`), or a .toml file that describes a model. Default: the model that the map's profile
    /// names.
    #[arg(long, value_name = "MODEL|FILE")]
    global: Option<String>,
}

impl MapGlobalArgs {
    /// Returns the map's own model, or `None` if its global descriptors are aggregated from local ones.
    ///
    /// # Errors
    /// The model is unknown, has no file, cannot be used, or is not the map's.
    pub(crate) fn extractor(
        &self,
        models: &Models,
        profile: &Profile,
    ) -> Result<Option<SharedGlobal>, Failure> {
        let requested = profile.global_model().name();
        let own = global_extractor(models, self.global.as_deref().unwrap_or(requested))?;
        fits(profile, own.as_ref())?;
        Ok(own)
    }
}

/// Consent to send a global descriptor that is computed from the whole image.
#[derive(clap::Args)]
pub(crate) struct ConsentArgs {
    /// Consent to send the global descriptor of this model if the map requests it: a name (`veiloc models`), or a .toml
    /// file that describes the model. It is computed from the whole image and reveals more than the local descriptors
    /// do (docs/reference/privacy-rules.md, rule L14). Default: no consent; maps that request such a descriptor are refused.
    #[arg(long, value_name = "MODEL|FILE")]
    image_global: Option<String>,
}

impl ConsentArgs {
    /// Returns the sealer for a map, with the owner's consent if it was given and the map requests the descriptor, and
    /// prints what is sent in addition.
    ///
    /// # Errors
    /// The map requests a descriptor without consent, or the model cannot be used.
    pub(crate) fn sealer(
        &self,
        options: SealOptions,
        models: &Models,
        profile: &Profile,
        ui: &Ui,
    ) -> Result<Sealer, Failure> {
        let (requested, of_rows) = (profile.global_model().name(), profile.vocabulary().is_some());
        let options = match &self.image_global {
            None => options,
            Some(_) if of_rows => {
                ui.info("the map requests no global descriptor of the whole image; none is sent");
                options
            }
            Some(name) => {
                let own = global_extractor(models, name)?;
                fits(profile, own.as_ref())?;
                ui.warn(format!(
                    "the global descriptor {requested} of the whole image is sent: it reveals more than the \
                     local descriptors do"
                ));
                own.map_or(options.clone(), |own| options.with_image_global(own))
            }
        };
        Sealer::new(profile, options).map_err(|refused| match refused {
            SealError::GlobalOfImage { .. } => {
                let help = format!(
                    "to send it, read docs/reference/privacy-rules.md, rule L14, and give --image-global {requested}; or \
                     query a map without it"
                );
                Failure::with_help(refused, help)
            }
            other => other.into(),
        })
    }
}

fn fits(profile: &Profile, own: Option<&SharedGlobal>) -> Result<(), Failure> {
    let requested = profile.global_model();
    let (name, codes) =
        own.map_or((VLAD.to_owned(), None), |own| (own.model().name().to_owned(), Some(own.model().dim())));
    if name == requested.name() && codes.is_none_or(|codes| codes == requested.global_len()) {
        return Ok(());
    }
    let numbers = codes.map_or_else(String::new, |codes| format!(" ({codes} numbers)"));
    Err(Failure::with_help(
        format!(
            "the map's global descriptors are {} ({} numbers), and {name}{numbers} is given: these do not \
             match",
            requested.name(),
            requested.global_len()
        ),
        "give the model that the map was built with",
    ))
}
