//! What does the cryptography.

use std::sync::Arc;

use tokio_rustls::rustls::crypto::{self, CryptoProvider};

/// What does the cryptography. The one that the MQTT broker's own dependencies bring.
pub(crate) fn provider() -> Arc<CryptoProvider> {
    Arc::new(crypto::ring::default_provider())
}
