//! Reading and writing the fields of messages. Nothing is indexed, so nothing panics.

use crate::error::TlsError;

/// Takes fields off the front of some bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn take(&mut self, count: usize) -> Result<&'a [u8], TlsError> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(TlsError::Malformed)?;
        self.0 = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], TlsError> {
        self.take(N)?.try_into().map_err(|_| TlsError::Malformed)
    }

    pub(crate) fn u8(&mut self) -> Result<u8, TlsError> {
        self.array().map(|[byte]| byte)
    }

    pub(crate) fn u16(&mut self) -> Result<u16, TlsError> {
        self.array().map(u16::from_be_bytes)
    }

    pub(crate) fn u24(&mut self) -> Result<usize, TlsError> {
        let [a, b, c] = self.array()?;
        Ok(u32::from_be_bytes([0, a, b, c]) as usize)
    }

    /// A field behind its length of one byte.
    pub(crate) fn short(&mut self) -> Result<Self, TlsError> {
        let length = self.u8()?;
        self.take(length.into()).map(Self)
    }

    /// A field behind its length of two bytes.
    pub(crate) fn long(&mut self) -> Result<Self, TlsError> {
        let length = self.u16()?;
        self.take(length.into()).map(Self)
    }

    /// Checks the form of a list of extensions, whatever they are.
    pub(crate) fn extensions(mut self) -> Result<(), TlsError> {
        while !self.is_empty() {
            let _kind = self.u16()?;
            self.long()?;
        }
        Ok(())
    }

    pub(crate) const fn rest(self) -> &'a [u8] {
        self.0
    }

    /// All has to be read.
    pub(crate) const fn end(self) -> Result<(), TlsError> {
        if self.0.is_empty() {
            Ok(())
        } else {
            Err(TlsError::Malformed)
        }
    }
}

/// Puts fields one behind the other.
#[derive(Debug)]
pub(crate) struct Writer<'a> {
    bytes: &'a mut [u8],
    len: usize,
}

impl<'a> Writer<'a> {
    pub(crate) const fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, len: 0 }
    }

    pub(crate) const fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn put(&mut self, field: &[u8]) -> Result<(), TlsError> {
        let end = self.len.saturating_add(field.len());
        self.bytes
            .get_mut(self.len..end)
            .ok_or(TlsError::Unusable)?
            .copy_from_slice(field);
        self.len = end;
        Ok(())
    }

    pub(crate) fn u16(&mut self, value: u16) -> Result<(), TlsError> {
        self.put(&value.to_be_bytes())
    }

    /// Writes what `fill` writes behind its length, which takes `width` bytes.
    pub(crate) fn counted(
        &mut self,
        width: usize,
        fill: impl FnOnce(&mut Self) -> Result<(), TlsError>,
    ) -> Result<(), TlsError> {
        let place = self.len;
        self.put([0; 4].get(..width).ok_or(TlsError::Unusable)?)?;
        fill(self)?;
        let length = (self.len - place - width) as u32;
        let length = length.to_be_bytes();
        let low = length.get(4 - width..).ok_or(TlsError::Unusable)?;
        self.bytes
            .get_mut(place..place + width)
            .ok_or(TlsError::Unusable)?
            .copy_from_slice(low);
        Ok(())
    }
}
