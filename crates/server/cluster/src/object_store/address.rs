//! Resolves a URL or a path to storage.

use std::path::Path;
use std::sync::Arc;

use object_store::ObjectStore;
use object_store::local::LocalFileSystem;
use object_store::path::Path as Location;
use url::Url;

use crate::ClusterError;

/// Storage, and the prefix in it.
pub(crate) type StorageLocation = (Arc<dyn ObjectStore>, Location);

/// What to do about a folder that does not exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MissingFolder {
    /// An error.
    Refuse,
    /// Create it.
    Create,
    /// Nothing: it may come later.
    Wait,
}

/// Resolves a URL; a path is a folder.
pub(crate) fn resolve(url: &str, missing: MissingFolder) -> Result<StorageLocation, ClusterError> {
    let wrong = |reason: String| ClusterError::StorageAddress { url: without_login(url), reason };
    if !url.contains("://") {
        return folder(Path::new(url), missing);
    }
    let parsed =
        Url::parse(url).map_err(|error| wrong(format!("not a URL ({error}); give {SUPPORTED_URLS}")))?;
    if !parsed.username().is_empty() || parsed.password().is_some() {
        return Err(wrong("credentials in a URL end up in logs; set them in the environment".to_owned()));
    }
    if parsed.query().is_some() || parsed.fragment().is_some() {
        return Err(wrong(format!("nothing may follow the path; give {SUPPORTED_URLS}")));
    }
    match parsed.scheme() {
        "file" => {
            let path = parsed.to_file_path();
            folder(
                &path.map_err(|()| wrong("a folder on another machine; give file:///PATH".to_owned()))?,
                missing,
            )
        }
        "s3" | "gs" | "az" => cloud(&parsed).map_err(|error| match error {
            Some(source) => ClusterError::Storage { address: url.to_owned(), source: Box::new(source) },
            None => wrong(
                "this program was built without cloud storage; build it with `--features clouds`".to_owned(),
            ),
        }),
        scheme => Err(wrong(format!("{scheme}:// is not known; give {SUPPORTED_URLS}"))),
    }
}

/// Removes user and password from a URL.
pub(crate) fn without_login(url: &str) -> String {
    match url.split_once("://").and_then(|(scheme, rest)| Some((scheme, rest.rsplit_once('@')?))) {
        Some((scheme, (_, rest))) => format!("{scheme}://{rest}"),
        None => url.to_owned(),
    }
}

const SUPPORTED_URLS: &str =
    "a path, file:///PATH, s3://BUCKET/PATH, gs://BUCKET/PATH or az://CONTAINER/PATH";

fn folder(path: &Path, missing: MissingFolder) -> Result<StorageLocation, ClusterError> {
    if missing == MissingFolder::Create {
        std::fs::create_dir_all(path).map_err(ClusterError::io(path))?;
    }
    let wrong = |source: object_store::Error| ClusterError::Storage {
        address: path.display().to_string(),
        source: Box::new(source),
    };
    match std::fs::metadata(path) {
        Ok(metadata) if !metadata.is_dir() => {
            Err(ClusterError::io(path)(std::io::Error::from(std::io::ErrorKind::NotADirectory)))
        }
        Ok(_) => {
            let store = LocalFileSystem::new_with_prefix(path).map_err(wrong)?;
            Ok((Arc::new(store.with_fsync(true)), Location::default()))
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound && missing == MissingFolder::Wait => {
            let whole = std::path::absolute(path).map_err(ClusterError::io(path))?;
            let root = Location::from_absolute_path(whole).map_err(|error| wrong(error.into()))?;
            Ok((Arc::new(LocalFileSystem::new().with_fsync(true)), root))
        }
        Err(error) => Err(ClusterError::io(path)(error)),
    }
}

/// Settings and credentials come from the environment, from the same variables as for the tools of the clouds.
#[cfg(feature = "clouds")]
fn cloud(url: &Url) -> Result<StorageLocation, Option<object_store::Error>> {
    use object_store::aws::AmazonS3Builder;
    use object_store::azure::MicrosoftAzureBuilder;
    use object_store::gcp::GoogleCloudStorageBuilder;
    use object_store::{ClientOptions, RetryConfig, path};

    // Only the first installed provider counts; an existing one is kept.
    let _ = rustls::crypto::ring::default_provider().install_default();
    // Downloading a region may take long; stalls are detected by the reader.
    let client = ClientOptions::new().with_timeout(MAX_REQUEST_TIME).with_allow_http(
        std::env::var("AWS_ALLOW_HTTP").is_ok_and(|v| v.eq_ignore_ascii_case("true") || v == "1"),
    );
    let location = path::Path::from_url_path(url.path()).map_err(object_store::Error::from)?;
    // Half a minute in total, including our own retries around it.
    let retry = RetryConfig { max_retries: RETRIES, ..RetryConfig::default() };
    let store: Arc<dyn ObjectStore> = match url.scheme() {
        "s3" => Arc::new(
            AmazonS3Builder::from_env()
                .with_url(url.as_str())
                .with_client_options(client)
                .with_retry(retry)
                .build()?,
        ),
        "gs" => Arc::new(
            GoogleCloudStorageBuilder::from_env()
                .with_url(url.as_str())
                .with_client_options(client)
                .with_retry(retry)
                .build()?,
        ),
        _ => Arc::new(
            MicrosoftAzureBuilder::from_env()
                .with_url(url.as_str())
                .with_client_options(client)
                .with_retry(retry)
                .build()?,
        ),
    };
    Ok((store, location))
}

#[cfg(not(feature = "clouds"))]
const fn cloud(_: &Url) -> Result<StorageLocation, Option<object_store::Error>> {
    Err(None)
}

/// Retries of one request, after 0.1 s, then twice as long each time.
#[cfg(feature = "clouds")]
const RETRIES: usize = 6;

#[cfg(feature = "clouds")]
const MAX_REQUEST_TIME: std::time::Duration = std::time::Duration::from_secs(3600);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_urls_are_refused_with_a_remedy() {
        for (url, expected) in [
            ("http://example.com/maps", "s3://BUCKET"),
            ("ftp://example.com", "s3://BUCKET"),
            ("file://elsewhere/maps", "file:///PATH"),
            ("s3://key:secret@bucket/maps", "environment"),
            ("s3://bucket/maps?versionId=1", "nothing may follow"),
            ("://", "not a URL"),
            ("s3://key:secret@bu^cket:x/maps", "not a URL"),
        ] {
            let error = resolve(url, MissingFolder::Refuse).expect_err(url);
            assert!(
                matches!(error, ClusterError::StorageAddress { .. }) && error.to_string().contains(expected),
                "{error}"
            );
            assert!(!error.to_string().contains("secret"), "{error}");
        }
        #[cfg(not(feature = "clouds"))]
        for url in ["s3://bucket/maps", "gs://bucket", "az://container/maps"] {
            assert!(
                resolve(url, MissingFolder::Refuse).expect_err(url).to_string().contains("--features clouds")
            );
        }
    }

    #[test]
    fn folder_is_created_on_request() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a b/maps");
        let text = path.to_str().unwrap();
        assert!(matches!(resolve(text, MissingFolder::Refuse), Err(ClusterError::Io { .. })));
        resolve(text, MissingFolder::Create).unwrap();
        resolve(text, MissingFolder::Refuse).unwrap();
        resolve(Url::from_file_path(&path).unwrap().as_str(), MissingFolder::Refuse).unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        for missing in [MissingFolder::Refuse, MissingFolder::Create, MissingFolder::Wait] {
            assert!(matches!(resolve(file.to_str().unwrap(), missing), Err(ClusterError::Io { .. })));
        }
    }
}
