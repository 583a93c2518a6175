//! What robots get of a release.

use std::sync::Arc;

use crawler_protocol::ReleaseId;
use crawler_records::{MAX_RELEASES, RecordsError, Releases};
use crawler_release::chunk::{PAYLOAD, Part};
use crawler_updates::delta::{BetweenFault, between};
use crawler_updates::release::join;
use crawler_updates::rollout::{BuildId, PlannedRelease};

/// A patch is worth it when it has no more bytes than this share of the image.
const WORTH_PERCENT: usize = 75;

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
        releases: Releases<'_>,
        release: &PlannedRelease,
    ) -> Result<Option<Arc<Self>>, RecordsError> {
        Self::read(releases, release.release.as_str(), release.bytes as usize).await
    }

    async fn read(
        releases: Releases<'_>,
        id: &str,
        bytes: usize,
    ) -> Result<Option<Arc<Self>>, RecordsError> {
        let (Some(kept), Ok(parsed)) = (releases.get(id).await?, id.parse()) else {
            return Ok(None);
        };
        let image = match releases.image(id, 0, bytes).await {
            // A piece is missing, and does not come back.
            Err(RecordsError::Invalid(_)) => None,
            image => image?,
        };
        let whole = image.filter(|image| image.len() == bytes);
        Ok(whole.map(|image| {
            Arc::new(Self {
                id: parsed,
                envelope: kept.envelope,
                image,
            })
        }))
    }

    /// A release with that build which a patch to this one can start from; `None` when none is kept, or it was
    /// withdrawn.
    pub(crate) async fn base(
        &self,
        releases: Releases<'_>,
        build: &BuildId,
    ) -> Result<Option<Arc<Self>>, RecordsError> {
        let id = self.id.text();
        let most = u32::try_from(MAX_RELEASES).unwrap_or(u32::MAX);
        let kept = releases.page(None, most).await?;
        let Some(own) = kept.iter().find(|one| one.id == id.as_str()) else {
            return Ok(None);
        };
        let base = kept.iter().find(|one| {
            let is_like = one.kind == own.kind && one.name == own.name && one.board == own.board;
            is_like && one.build == build.as_str() && one.withdrawn.is_none() && one.id != own.id
        });
        match base {
            Some(base) => Self::read(releases, &base.id, base.size as usize).await,
            None => Ok(None),
        }
    }

    /// The patch that makes this release out of `base`; `None` where there is none, or none that is worth it. Takes half
    /// a second, and ten times as much memory as both images.
    pub(crate) fn patch(&self, base: &Self) -> Option<Vec<u8>> {
        let from = join(&base.envelope, &base.image).ok()?;
        let to = join(&self.envelope, &self.image).ok()?;
        match between(&from, &to) {
            Ok(made) => {
                let most = self.image.len() / 100 * WORTH_PERCENT;
                (made.patch.len() <= most).then_some(made.patch)
            }
            Err(fault @ BetweenFault::Wrong) => {
                tracing::error!(from = %base.id, to = %self.id, %fault, "images come as they are");
                None
            }
            Err(fault) => {
                tracing::debug!(from = %base.id, to = %self.id, %fault, "images come as they are");
                None
            }
        }
    }

    /// What chunk `index` of `part` holds; `None` when there is no such chunk.
    pub(crate) fn payload(&self, part: Part, index: u32) -> Option<&[u8]> {
        let whole = match part {
            Part::Manifest => &self.envelope,
            Part::Image => &self.image,
            // Which one depends on the robot.
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
    use crawler_records::{NewRelease, Records, Withdrawal};
    use crawler_release::{Chip, Kind, Requires};
    use crawler_updates::delta::apply;
    use crawler_updates::release::{SecretKey, SignOptions};

    use super::*;

    /// A release that is kept.
    async fn keep(records: &Records, board: &str, build: &str, image: &[u8]) -> Arc<Blob> {
        let options = SignOptions {
            kind: Kind::Program,
            name: None,
            board,
            chip: Some(Chip::NONE),
            version: "1",
            build: Some(build),
            sequence: 4,
            floor: 0,
            expires: None,
            requires: Requires::default(),
        };
        let key = SecretKey::generate().expect("random numbers");
        let envelope = options.sign(image, &key).expect("signed");
        let new = NewRelease::of(&envelope, image, "ada", 1).expect("a release");
        let id = new.id.clone();
        records.releases().add(new).await.expect("kept");
        let blob = Blob::read(records.releases(), &id, image.len()).await;
        blob.expect("read").expect("there")
    }

    /// Bytes that nothing else has in common with.
    fn noise(seed: u32, bytes: usize) -> Vec<u8> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        (0..bytes).map(|_| next()).collect()
    }

    #[tokio::test]
    async fn a_patch_starts_from_a_release_like_it_that_was_not_withdrawn() {
        let records = Records::in_memory().await.expect("records");
        let old = noise(1, 30_000);
        let mut image = old.clone();
        image[20_000] ^= 1;
        keep(&records, "virt", "old", &old).await;
        keep(&records, "other", "elsewhere", &old).await;
        keep(&records, "virt", "unlike", &noise(2, 30_000)).await;
        let new = keep(&records, "virt", "new", &image).await;
        let base = async |build: &str| {
            let build = BuildId::new(build).expect("a build");
            new.base(records.releases(), &build).await.expect("read")
        };
        let found = base("old").await.expect("a release");
        let patch = new.patch(&found).expect("a patch");
        assert!(patch.len() < 1_000, "{}", patch.len());
        assert_eq!(apply(&old, 30_000, &patch), Ok(image));
        let unlike = base("unlike").await.expect("a release");
        assert_eq!(new.patch(&unlike), None, "it is not worth it");
        for build in ["new", "elsewhere", "nobodys"] {
            assert!(base(build).await.is_none(), "{build}");
        }
        let withdrawal = Withdrawal {
            by: "ada".to_owned(),
            at: 2,
            why: "it is bad".to_owned(),
        };
        let id = found.id.to_string();
        let done = records.releases().withdraw(&id, withdrawal).await;
        done.expect("withdrawn");
        assert!(base("old").await.is_none());
    }

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
