//! Trains the vocabulary of a map on a sample of all its descriptors.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorView, Descriptors, Vocabulary};
use veiloc_map::BuildSettings;

use crate::error::MappingError;
use crate::progress::Progress;

/// Trains words on the descriptors of images: as many as the settings request, or as there are descriptors. Equal
/// images and settings give equal words.
///
/// # Errors
/// [`MappingError::EmptyList`] without images, [`MappingError::NoKeypoints`] if there are too few descriptors.
pub(crate) fn learn(
    images: &[DescriptorView<'_>],
    settings: &BuildSettings,
    progress: &dyn Progress,
) -> Result<Vocabulary, MappingError> {
    progress.start("Training the vocabulary", 1);
    let kind = images.first().map(DescriptorView::kind).ok_or(MappingError::EmptyList)?;
    let total: usize = images.iter().map(DescriptorView::len).sum();
    let words = (settings.vocabulary_words as usize).min(total.max(1));
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let chosen = rand::seq::index::sample(&mut rng, total, total.min(words * SAMPLES_PER_WORD));
    let mut chosen = chosen.into_vec();
    chosen.sort_unstable();
    let mut sample = Descriptors::empty(kind);
    let (mut image, mut before) = (0, 0);
    for index in chosen {
        while index - before >= images[image].len() {
            before += images[image].len();
            image += 1;
        }
        sample.push(images[image].row(index - before)).expect("all rows have the same kind");
    }
    let vocabulary = Vocabulary::train(sample.view(), words, &mut rng)
        .map_err(|source| MappingError::NoKeypoints { images: images.len(), source })?;
    progress.advance(1);
    Ok(vocabulary)
}

/// Training descriptors per word.
const SAMPLES_PER_WORD: usize = 1000;
