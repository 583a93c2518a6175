//! What two images have in common, as the records of a patch.

use std::convert::Infallible;

use bidiff::{Control, DiffParams, Translator};

/// Appends a number as detools writes it (`pack_size` in its `bsdiff.c`).
pub(super) fn push_number(out: &mut Vec<u8>, value: i64) {
    let mut rest = value.unsigned_abs();
    let sign = if value < 0 { 0x40 } else { 0 };
    let mut byte = (rest & 0x3F) as u8 | sign;
    rest >>= 6;
    while rest > 0 {
        out.push(byte | 0x80);
        byte = (rest & 0x7F) as u8;
        rest >>= 7;
    }
    out.push(byte);
}

/// What a patch from `old` to `new` has behind its head, not compressed. `new` must not be empty.
pub(super) fn between(old: &[u8], new: &[u8]) -> Vec<u8> {
    // No data format.
    let mut out = vec![0];
    if old.is_empty() {
        push_record(&mut out, &[], new, 0);
        return out;
    }
    let write = |record: &Control<'_>| -> Result<(), Infallible> {
        push_record(&mut out, record.add, record.copy, record.seek);
        Ok(())
    };
    let mut records = Translator::new(old, new, write);
    let Ok(()) = bidiff::diff(old, new, &DiffParams::default(), |found| {
        records.translate(found)
    });
    let Ok(()) = records.close();
    out
}

fn push_record(out: &mut Vec<u8>, differences: &[u8], bytes: &[u8], distance: i64) {
    push_number(out, differences.len() as i64);
    out.extend_from_slice(differences);
    push_number(out, bytes.len() as i64);
    out.extend_from_slice(bytes);
    push_number(out, distance);
}
