//! Fuzz target of the images of simulated robots. The fuzzer and the replay of its corpus in the tests of
//! `crawler-bundle` include this file.

use crawler_bundle::{DIGEST_BYTES, Digest, Header, SIZE_MAX, decode};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 1] = [("bundle", bundle)];

/// A header that is read is the one that would be written, and what it says is bounded; an image that is read
/// begins with it and ends with its digest.
fn bundle(data: &[u8]) {
    let header = Header::decode(data);
    let image = decode(data);
    let Ok(header) = header else {
        assert!(image.is_err(), "an image without a header");
        return;
    };
    let written = header.encode().expect("what was read can be written");
    assert_eq!(data[..written.len()], written);
    assert!(header.size <= SIZE_MAX);
    assert!(header.size as usize >= written.len() + DIGEST_BYTES);
    // A digest that fits is hard to guess.
    let end = header.size as usize - DIGEST_BYTES;
    let whole = data.len() >= end && data.len() < end + 4_096;
    if whole {
        let mut image = data[..end].to_vec();
        let mut digest = Digest::new();
        digest.update(&image);
        image.extend(digest.finish());
        assert_eq!(decode(&image).as_ref(), Ok(&header.bundle));
    }
    if let Ok(bundle) = image {
        assert_eq!(bundle, header.bundle);
        assert_eq!(data.len(), header.size as usize);
    }
}
