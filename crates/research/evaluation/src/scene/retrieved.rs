//! Map images that another program retrieved for each query, as hloc's lists of pairs name them.

use std::borrow::Cow;
use std::collections::BTreeMap;

use veiloc_localization::LocalizeOptions;
use veiloc_map::MapFile;
use veiloc_mapping::NameIndex;

use super::options::SceneEvaluation;
use crate::error::EvalError;

/// Names of map images by the name of the query, best first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetrievedImages(BTreeMap<String, Vec<String>>);

impl RetrievedImages {
    /// From pairs of a query and a map image; of one query the best first, as hloc writes them.
    pub fn of_pairs(pairs: impl IntoIterator<Item = (String, String)>) -> Self {
        let mut images: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (query, image) in pairs {
            images.entry(query).or_default().push(image);
        }
        Self(images)
    }

    fn of_query(&self, name: &str) -> &[String] {
        self.0.get(name).map_or(&[], Vec::as_slice)
    }

    /// How many pairs of the scene's queries name an image that is not mapped; they are left out.
    ///
    /// # Errors
    /// [`EvalError::DataSet`] for a query without any mapped image.
    pub fn check<'a>(
        &self,
        queries: impl IntoIterator<Item = &'a str>,
        mapped: &[String],
    ) -> Result<usize, EvalError> {
        let mapped = NameIndex::new(mapped.iter().map(|name| (name.as_str(), ())));
        let mut left_out = 0;
        for query in queries {
            let images = self.of_query(query);
            let unknown = images.iter().filter(|name| mapped.get(name).is_none()).count();
            left_out += unknown;
            if unknown == images.len() {
                return Err(EvalError::DataSet(format!(
                    "{query}: the list of pairs has no map image for this query; give the list of these queries, \
                     `QUERY MAP_IMAGE` in each line"
                )));
            }
        }
        Ok(left_out)
    }
}

impl SceneEvaluation {
    /// Options of one query in this map: with the images that the list of pairs names for it, if there is a list.
    pub(super) fn with_retrieved<'a>(
        &self,
        options: &'a LocalizeOptions,
        query: &str,
        map: &MapFile,
    ) -> Cow<'a, LocalizeOptions> {
        let Some(images) = &self.retrieved else { return Cow::Borrowed(options) };
        let of_map: Vec<_> = map.images().collect();
        let index = NameIndex::new(of_map.iter().enumerate().map(|(at, image)| (image.name(), at)));
        let found = images.of_query(query).iter().filter_map(|name| index.get(name)).collect();
        let mut own = options.clone();
        own.retrieved = Some(found);
        Cow::Owned(own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queries_need_a_mapped_image_and_others_are_counted() {
        let pairs = [("q/1.jpg", "db/2.jpg"), ("q/1.jpg", "db/1.jpg"), ("q/2.jpg", "db/9.jpg")];
        let images = RetrievedImages::of_pairs(pairs.map(|(q, i)| (q.to_owned(), i.to_owned())));
        assert_eq!(images.of_query("q/1.jpg"), ["db/2.jpg", "db/1.jpg"], "the order of the list");
        let mapped = ["db/1.jpg".to_owned()];
        assert_eq!(images.check(["q/1.jpg"], &mapped).expect("one is mapped"), 1);
        for query in ["q/2.jpg", "q/3.jpg"] {
            let error = images.check([query], &mapped).expect_err("none is mapped").to_string();
            assert!(error.contains(query) && error.contains("pairs"), "{error}");
        }
    }
}
