//! The owner's certificate and its key, for TLS.

use crate::failure::Failure;
use firmware_config::ServeConfig;
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use std::fs::File;
use std::io::Read;
use std::sync::Arc;

/// Bytes of the longest file that is read.
const LONGEST: u64 = 1 << 20;

/// TLS with the certificate that the settings name; `None` if they name none.
///
/// # Errors
/// One of the two files is missing, unreadable or of another kind, or the key is not that of the certificate.
pub fn tls(config: &ServeConfig) -> Result<Option<Arc<ServerConfig>>, Failure> {
    let (certificate, key) = (&config.certificate_file, &config.key_file);
    match (certificate.is_empty(), key.is_empty()) {
        (true, true) => return Ok(None),
        (false, false) => {}
        _ => return Err(usage("set both serve.certificate_file and serve.key_file, or neither")),
    }
    let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_slice_iter(&read("certificate_file", certificate)?)
        .collect::<Result<_, _>>()
        .map_err(|e| usage(format!("serve.certificate_file: {certificate}: {e}; a PEM file is expected")))?;
    if chain.is_empty() {
        return Err(usage(format!(
            "serve.certificate_file: {certificate} holds no certificate; a PEM file is expected"
        )));
    }
    let private = PrivateKeyDer::from_pem_slice(&read("key_file", key)?).map_err(|e| {
        usage(format!("serve.key_file: {key}: {e}; a PEM file with a key that has no password is expected"))
    })?;
    let mut tls = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| Failure::Internal(e.to_string()))?
        .with_no_client_auth()
        .with_single_cert(chain, private)
        .map_err(|e| usage(format!("{certificate} and {key} do not go together: {e}")))?;
    tls.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Some(Arc::new(tls)))
}

fn usage(text: impl Into<String>) -> Failure {
    Failure::Usage(text.into())
}

fn read(setting: &str, path: &str) -> Result<Vec<u8>, Failure> {
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(LONGEST).read_to_end(&mut bytes))
        .map_err(|e| usage(format!("serve.{setting}: {path}: {e}; name a file that the program may read")))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_do_not_fit_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let pair = |name: &str| {
            let made = rcgen::generate_simple_self_signed(vec!["box.local".into()]).unwrap();
            let path = |kind: &str| folder.path().join(format!("{name}.{kind}")).display().to_string();
            std::fs::write(path("crt"), made.cert.pem()).unwrap();
            std::fs::write(path("key"), made.signing_key.serialize_pem()).unwrap();
            (path("crt"), path("key"))
        };
        let of = |certificate: &str, key: &str| {
            tls(&ServeConfig { certificate_file: certificate.into(), key_file: key.into(), ..ServeConfig::default() })
        };
        let (a, b) = (pair("a"), pair("b"));
        assert!(of("", "").unwrap().is_none() && of(&a.0, &a.1).unwrap().is_some());
        for (certificate, key, said) in [
            (a.0.as_str(), "", "both"),
            (&a.0, &b.1, "do not go together"),
            (&a.1, &a.1, "no certificate"),
            (&a.0, &a.0, "serve.key_file"),
            ("/nowhere", &a.1, "serve.certificate_file: /nowhere"),
        ] {
            let text = of(certificate, key).map(|_| ()).unwrap_err().to_string();
            assert!(text.contains(said), "{text}");
        }
    }
}
