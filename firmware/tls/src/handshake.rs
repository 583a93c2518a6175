//! The handshake (RFC 8446, section 4), from the `ClientHello` to both Finished messages.

use p256::PublicKey;
use p256::ecdh::EphemeralSecret;
use p256::elliptic_curve::Generate;
use p256::elliptic_curve::sec1::ToSec1Point;
use rand_core::CryptoRng;
use sha2::{Digest, Sha256};

use crate::error::TlsError;
use crate::expected::Expected;
use crate::hello::ECDSA_SECP256R1_SHA256;
use crate::keys::{self, HASH, Secret};
use crate::name::Name;
use crate::reader::Reader;
use crate::record::Keys;
use crate::sizes::POINT;
use crate::{certificate, chain, hello};

const SERVER_HELLO: u8 = 2;
const ENCRYPTED_EXTENSIONS: u8 = 8;
const CERTIFICATE: u8 = 11;
const CERTIFICATE_REQUEST: u8 = 13;
const CERTIFICATE_VERIFY: u8 = 15;
const FINISHED: u8 = 20;

/// The server's share of the key: uncompressed, and on the curve (section 4.2.8.2).
pub(crate) fn public(share: &[u8; POINT]) -> Result<PublicKey, TlsError> {
    PublicKey::from_sec1_bytes(share).map_err(|_| TlsError::Choice)
}

/// Checks the form of a `NewSessionTicket` (section 4.6.1), `whole` with its header. Nothing is resumed.
pub(crate) fn check_ticket(whole: &[u8]) -> Result<(), TlsError> {
    let mut r = Reader::new(whole);
    let _header: [u8; 4] = r.array()?;
    let (_lifetime, _age_add): ([u8; 4], [u8; 4]) = (r.array()?, r.array()?);
    let _nonce = r.short()?;
    if r.long()?.is_empty() {
        return Err(TlsError::Malformed);
    }
    r.long()?.extensions()?;
    r.end()
}

/// Bytes of the last messages of a client: a Certificate without certificates, and Finished.
const FAREWELL: usize = 8 + 4 + HASH;

/// What comes next.
enum Next {
    ServerHello(EphemeralSecret),
    EncryptedExtensions,
    /// A request for ours may come before it.
    Certificate,
    CertificateVerify(ServerKey),
    Finished,
    Done,
}

/// The key of the server.
type ServerKey = [u8; POINT];

/// A handshake.
pub(crate) struct Handshake {
    transcript: Sha256,
    next: Next,
    /// The server asked for a certificate; it gets an empty list.
    asked: bool,
    /// The secret of the stage, then those of the two sides.
    stage: Secret,
    client: Secret,
    server: Secret,
}

/// What a message led to.
// Moved once, from one function to its caller.
#[allow(clippy::large_enum_variant)]
pub(crate) enum Outcome {
    /// The next message.
    Next,
    /// From here on records are encrypted.
    Encrypted { read: Keys, write: Keys },
    /// The most that content and type of a record of ours may take.
    Limit(u16),
    /// What is to be said with the keys there are, and the keys for everything after that.
    Done {
        last: [u8; FAREWELL],
        length: usize,
        read: Keys,
        write: Keys,
    },
}

impl Handshake {
    /// Draws a key and writes the first message to `out`; its length.
    pub(crate) fn start(
        expected: &Expected<'_>,
        rng: &mut impl CryptoRng,
        out: &mut [u8],
    ) -> Result<(Self, usize), TlsError> {
        let name = Name::new(expected.host)?;
        let mut random = [0; HASH];
        rng.fill_bytes(&mut random);
        let secret = EphemeralSecret::generate_from_rng(rng);
        let share = secret.public_key().to_sec1_point(false);
        let length = hello::write(out, &random, name, share.as_bytes())?;
        let mut transcript = Sha256::new();
        transcript.update(out.get(..length).ok_or(TlsError::Unusable)?);
        let handshake = Self {
            transcript,
            next: Next::ServerHello(secret),
            asked: false,
            stage: Secret::default(),
            client: Secret::default(),
            server: Secret::default(),
        };
        Ok((handshake, length))
    }

    fn hash(&self) -> [u8; HASH] {
        self.transcript.clone().finalize().into()
    }

    /// Whether the server has been heard, so that it could say that nothing changes.
    pub(crate) const fn is_encrypted(&self) -> bool {
        !matches!(self.next, Next::ServerHello(_))
    }

    /// Takes one message, `whole` with its header.
    pub(crate) fn message(
        &mut self,
        whole: &[u8],
        expected: &Expected<'_>,
    ) -> Result<Outcome, TlsError> {
        let mut r = Reader::new(whole);
        let kind = r.u8()?;
        let length = r.u24()?;
        let body = r.take(length)?;
        r.end()?;
        // An error ends the handshake.
        match (core::mem::replace(&mut self.next, Next::Done), kind) {
            (Next::ServerHello(secret), SERVER_HELLO) => {
                let share = hello::read(body, Name::new(expected.host)?)?;
                self.transcript.update(whole);
                self.agree(&secret, &share)
            }
            (Next::EncryptedExtensions, ENCRYPTED_EXTENSIONS) => {
                let limit = hello::read_encrypted(body, Name::new(expected.host)?)?;
                self.transcript.update(whole);
                self.next = Next::Certificate;
                Ok(limit.map_or(Outcome::Next, Outcome::Limit))
            }
            (Next::Certificate, CERTIFICATE_REQUEST) if !self.asked => {
                let mut r = Reader::new(body);
                // The context is for requests after the handshake.
                if !r.short()?.is_empty() {
                    return Err(TlsError::Malformed);
                }
                // Whatever they ask for, there is nothing to show.
                r.long()?.extensions()?;
                r.end()?;
                self.asked = true;
                self.transcript.update(whole);
                self.next = Next::Certificate;
                Ok(Outcome::Next)
            }
            (Next::Certificate, CERTIFICATE) => {
                let mut r = Reader::new(body);
                if !r.short()?.is_empty() {
                    return Err(TlsError::Malformed);
                }
                let length = r.u24()?;
                let list = r.take(length)?;
                r.end()?;
                let key = chain::check(list, expected)?;
                self.transcript.update(whole);
                self.next = Next::CertificateVerify(key);
                Ok(Outcome::Next)
            }
            (Next::CertificateVerify(key), CERTIFICATE_VERIFY) => {
                self.check_possession(&key, body)?;
                self.transcript.update(whole);
                self.next = Next::Finished;
                Ok(Outcome::Next)
            }
            (Next::Finished, FINISHED) => {
                keys::check_finished(&self.server, &self.hash(), body)?;
                self.transcript.update(whole);
                self.finish()
            }
            _ => Err(TlsError::Unexpected),
        }
    }

    /// Section 7.1, down to the secrets of the handshake.
    fn agree(
        &mut self,
        secret: &EphemeralSecret,
        share: &[u8; POINT],
    ) -> Result<Outcome, TlsError> {
        let shared = secret.diffie_hellman(&public(share)?);
        self.stage = keys::handshake(shared.raw_secret_bytes())?;
        let hash = self.hash();
        self.client = keys::derive(&self.stage, "c hs traffic", &hash)?;
        self.server = keys::derive(&self.stage, "s hs traffic", &hash)?;
        self.next = Next::EncryptedExtensions;
        Ok(Outcome::Encrypted {
            read: Keys::new(self.server.clone())?,
            write: Keys::new(self.client.clone())?,
        })
    }

    /// Section 4.4.3.
    fn check_possession(&self, key: &[u8; POINT], body: &[u8]) -> Result<(), TlsError> {
        let mut r = Reader::new(body);
        let scheme = r.u16()?;
        let signature = r.long()?.rest();
        r.end()?;
        if scheme != ECDSA_SECP256R1_SHA256 {
            return Err(TlsError::Algorithm);
        }
        let parts: [&[u8]; 3] = [
            &[0x20; 64],
            b"TLS 1.3, server CertificateVerify\0",
            &self.hash(),
        ];
        match certificate::verify(key, &parts, signature) {
            Ok(true) => Ok(()),
            Ok(false) | Err(_) => Err(TlsError::Signature),
        }
    }

    fn finish(&mut self) -> Result<Outcome, TlsError> {
        let hash = self.hash();
        let master = keys::master(&self.stage)?;
        let read = Keys::new(keys::derive(&master, "s ap traffic", &hash)?)?;
        let write = Keys::new(keys::derive(&master, "c ap traffic", &hash)?)?;
        let mut last = [0; FAREWELL];
        let mut w = crate::reader::Writer::new(&mut last);
        if self.asked {
            let none = [CERTIFICATE, 0, 0, 4, 0, 0, 0, 0];
            self.transcript.update(none);
            w.put(&none)?;
        }
        w.put(&[FINISHED, 0, 0, HASH as u8])?;
        w.put(&keys::finished(&self.client, &self.hash())?)?;
        let length = w.len();
        Ok(Outcome::Done {
            last,
            length,
            read,
            write,
        })
    }
}
