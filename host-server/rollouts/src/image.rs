//! What robots get of a release.

use std::sync::Arc;

use crawler_protocol::ReleaseId;
use crawler_records::{Records, RecordsError};
use crawler_release::chunk::{PAYLOAD, Part};
use crawler_updates::rollout::PlannedRelease;

/// A release that is rolled out, in memory.
#[derive(Debug)]
pub(crate) struct Blob {
    /// As it goes over the wire.
    pub(crate) id: ReleaseId,
    envelope: Vec<u8>,
    image: Vec<u8>,
}

impl Blob {
    /// What is kept of `release`; `None` when there is nothing of it that could be sent.
    pub(crate) async fn load(
        records: &Records,
        release: &PlannedRelease,
    ) -> Result<Option<Arc<Self>>, RecordsError> {
        let id = release.release.as_str();
        let releases = records.releases();
        let (Some(kept), Ok(parsed)) = (releases.get(id).await?, id.parse()) else {
            return Ok(None);
        };
        let image = match releases.image(id, 0, release.bytes as usize).await {
            // A piece is missing, and does not come back.
            Err(RecordsError::Invalid(_)) => None,
            image => image?,
        };
        let whole = image.filter(|image| image.len() == release.bytes as usize);
        Ok(whole.map(|image| {
            Arc::new(Self {
                id: parsed,
                envelope: kept.envelope,
                image,
            })
        }))
    }

    /// What chunk `index` of `part` holds; `None` when there is no such chunk.
    pub(crate) fn payload(&self, part: Part, index: u32) -> Option<&[u8]> {
        let whole = match part {
            Part::Manifest => &self.envelope,
            Part::Image => &self.image,
            Part::Delta => return None,
        };
        let from = (index as usize).checked_mul(PAYLOAD)?;
        let rest = whole.get(from..)?;
        let payload = &rest[..rest.len().min(PAYLOAD)];
        (!payload.is_empty()).then_some(payload)
    }

    #[cfg(test)]
    pub(crate) fn of(id: ReleaseId, envelope: Vec<u8>, image: Vec<u8>) -> Arc<Self> {
        Arc::new(Self {
            id,
            envelope,
            image,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_cover_the_image_and_no_more() {
        let image: Vec<u8> = (0..2_500).map(|n| (n % 251) as u8).collect();
        let blob = Blob::of(ReleaseId::new([1; 8]), vec![9; 300], image.clone());
        let chunks: Vec<u8> = (0..3)
            .flat_map(|index| blob.payload(Part::Image, index).expect("a chunk"))
            .copied()
            .collect();
        assert_eq!(chunks, image);
        assert_eq!(blob.payload(Part::Image, 2).map(<[u8]>::len), Some(452));
        assert_eq!(blob.payload(Part::Manifest, 0), Some(&[9; 300][..]));
        for (part, index) in [
            (Part::Image, 3),
            (Part::Image, u32::MAX),
            (Part::Manifest, 1),
            (Part::Delta, 0),
        ] {
            assert_eq!(blob.payload(part, index), None, "{part:?} {index}");
        }
        let even = Blob::of(ReleaseId::new([1; 8]), Vec::new(), vec![0; 2 * PAYLOAD]);
        assert!(even.payload(Part::Image, 1).is_some());
        assert_eq!(even.payload(Part::Image, 2), None);
        assert_eq!(even.payload(Part::Manifest, 0), None);
    }
}
