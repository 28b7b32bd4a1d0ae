//! Tests of `image_metrics`.

mod oracle;
