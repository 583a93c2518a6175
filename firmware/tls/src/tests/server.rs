//! A server that can be told to misbehave, made of the same parts as the client.

use std::boxed::Box;
use std::vec;
use std::vec::Vec;

use p256::PublicKey;
use p256::ecdh::EphemeralSecret;
use p256::ecdsa::signature::Signer;
use p256::ecdsa::{Signature, SigningKey};
use p256::elliptic_curve::Generate;
use p256::elliptic_curve::sec1::ToSec1Point;
use sha2::{Digest, Sha256};

use super::interop::{Made, server, server_params};
use super::{Peer, TestRng, record};
use crate::keys::{Secret, derive, finished, handshake, master};
use crate::record::{HANDSHAKE, Keys, OVERHEAD};

/// One handshake of the server.
pub(super) struct Flight {
    key: SigningKey,
    list: Vec<u8>,
    transcript: Sha256,
    /// The client's share.
    theirs: [u8; 65],
    stage: Secret,
    secret: Secret,
    pub(super) keys: Option<Keys>,
}

fn message(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut message = vec![kind];
    message.extend_from_slice(&(body.len() as u32).to_be_bytes()[1..]);
    message.extend_from_slice(body);
    message
}

/// Extensions, each a number and its content.
pub(super) fn extensions(list: &[(u16, &[u8])]) -> Vec<u8> {
    let mut all = Vec::new();
    for (number, content) in list {
        all.extend(number.to_be_bytes());
        all.extend((content.len() as u16).to_be_bytes());
        all.extend_from_slice(content);
    }
    let mut counted = (all.len() as u16).to_be_bytes().to_vec();
    counted.extend(all);
    counted
}

impl Flight {
    fn new(root: &Made, hello: &[u8]) -> Self {
        let (chain, key) = server(root, &server_params());
        let mut list = (chain[0].len() as u32).to_be_bytes()[1..].to_vec();
        list.extend_from_slice(&chain[0]);
        list.extend([0, 0]);
        // Where PKCS #8 has the number.
        let key = SigningKey::from_slice(&key.secret_der()[36..68]).expect("P-256");
        Self {
            key,
            list,
            transcript: Sha256::new_with_prefix(hello),
            // The last thing that is in it.
            theirs: hello[hello.len() - 65..].try_into().unwrap(),
            stage: Secret::default(),
            secret: Secret::default(),
            keys: None,
        }
    }

    fn hash(&self) -> [u8; 32] {
        self.transcript.clone().finalize().into()
    }

    fn said(&mut self, message: Vec<u8>) -> Vec<u8> {
        self.transcript.update(&message);
        message
    }

    /// A `ServerHello` with these fields; agrees on keys.
    pub(super) fn hello_with(
        &mut self,
        random: [u8; 32],
        suite: u16,
        more: &[(u16, &[u8])],
    ) -> Vec<u8> {
        let own = EphemeralSecret::generate_from_rng(&mut TestRng(2));
        let mut share = vec![0, 23, 0, 65];
        share.extend_from_slice(own.public_key().to_sec1_point(false).as_bytes());
        let mut body = vec![3, 3];
        body.extend(random);
        body.push(0);
        body.extend(suite.to_be_bytes());
        body.push(0);
        let mut list = more.to_vec();
        if !list.iter().any(|(number, _)| *number == 51) {
            list.push((51, &share));
        }
        body.extend(extensions(&list));
        let hello = self.said(message(2, &body));
        let theirs = PublicKey::from_sec1_bytes(&self.theirs).unwrap();
        let shared = own.diffie_hellman(&theirs);
        self.stage = handshake(shared.raw_secret_bytes()).unwrap();
        self.secret = derive(&self.stage, "s hs traffic", &self.hash()).unwrap();
        self.keys = Some(Keys::new(self.secret.clone()).unwrap());
        hello
    }

    pub(super) fn hello(&mut self) -> Vec<u8> {
        self.hello_with([9; 32], 0x1303, &[(43, &[3, 4])])
    }

    pub(super) fn encrypted(&mut self, list: &[(u16, &[u8])]) -> Vec<u8> {
        self.said(message(8, &extensions(list)))
    }

    /// A request for a certificate of the client, with these extensions.
    pub(super) fn request(&mut self, list: &[u8]) -> Vec<u8> {
        let mut body = vec![0];
        body.extend((list.len() as u16).to_be_bytes());
        body.extend_from_slice(list);
        self.said(message(13, &body))
    }

    pub(super) fn certificate(&mut self) -> Vec<u8> {
        let mut body = vec![0];
        body.extend_from_slice(&(self.list.len() as u32).to_be_bytes()[1..]);
        body.extend_from_slice(&self.list);
        self.said(message(11, &body))
    }

    /// With the signature over something else when `wrong`.
    pub(super) fn verify(&mut self, scheme: u16, wrong: bool) -> Vec<u8> {
        let mut text = vec![0x20; 64];
        text.extend_from_slice(b"TLS 1.3, server CertificateVerify\0");
        text.extend(self.hash());
        if wrong {
            text.push(0);
        }
        let signature: Signature = self.key.sign(&text);
        let (r, s) = signature.split_bytes();
        let mut der = Vec::new();
        for number in [r, s] {
            let digits = number.iter().skip_while(|byte| **byte == 0);
            let mut digits: Vec<u8> = digits.copied().collect();
            if digits[0] >= 0x80 {
                digits.insert(0, 0);
            }
            der.extend([2, digits.len() as u8]);
            der.extend(digits);
        }
        let mut body = scheme.to_be_bytes().to_vec();
        body.extend((der.len() as u16 + 2).to_be_bytes());
        body.extend([0x30, der.len() as u8]);
        body.extend(der);
        self.said(message(15, &body))
    }

    pub(super) fn finished(&mut self, wrong: bool) -> Vec<u8> {
        let mut mac = finished(&self.secret, &self.hash()).unwrap();
        mac[31] ^= u8::from(wrong);
        self.said(message(20, &mac))
    }

    /// The whole of it but for the hello.
    pub(super) fn rest(&mut self) -> Vec<u8> {
        let mut rest = self.encrypted(&[]);
        rest.extend(self.certificate());
        rest.extend(self.verify(0x0403, false));
        rest.extend(self.finished(false));
        rest
    }

    /// From now on with the keys for data.
    pub(super) fn open(&mut self) {
        let master = master(&self.stage).unwrap();
        let secret = derive(&master, "s ap traffic", &self.hash()).unwrap();
        self.keys = Some(Keys::new(secret).unwrap());
    }

    /// An encrypted record.
    pub(super) fn seal(&mut self, kind: u8, content: &[u8]) -> Vec<u8> {
        let mut out = vec![0; content.len() + OVERHEAD];
        let keys = self.keys.as_mut().expect("after the hello");
        keys.seal(kind, content, &mut out).unwrap();
        out
    }

    pub(super) fn sealed_rest(&mut self) -> Vec<u8> {
        let rest = self.rest();
        self.seal(HANDSHAKE, &rest)
    }

    pub(super) fn clear_hello(&mut self) -> Vec<u8> {
        let hello = self.hello();
        record(HANDSHAKE, &hello)
    }
}

/// What a server says to a hello.
pub(super) type Script = Box<dyn FnMut(&mut Flight) -> Vec<u8>>;

/// Plays a script, once.
pub(super) struct Scripted<'r> {
    pub(super) root: &'r Made,
    pub(super) script: Option<Script>,
}

impl Peer for Scripted<'_> {
    fn take(&mut self, bytes: &[u8]) -> Vec<u8> {
        match self.script.take() {
            Some(mut script) if !bytes.is_empty() => {
                script(&mut Flight::new(self.root, &bytes[5..]))
            }
            script => {
                self.script = script;
                Vec::new()
            }
        }
    }
}
