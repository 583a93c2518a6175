//! A fence: a polygon of the ground that robots are to stay in or out of.

use crawler_records::KeptFence;
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::ToSchema;

use super::shape::Shape;

/// So far, in metres, a robot must be on the right side before it counts as back: a pose that is sure
/// to a few centimetres makes one crossing of each.
pub(crate) const HYSTERESIS: f64 = 0.1;

/// On which side of its edge robots are to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FenceKind {
    /// Within.
    KeepIn,
    /// Outside.
    KeepOut,
}

impl FenceKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::KeepIn, Self::KeepOut];

    /// The name in messages, records and metrics.
    pub const fn name(self) -> &'static str {
        match self {
            Self::KeepIn => "keep_in",
            Self::KeepOut => "keep_out",
        }
    }
}

/// What happens to a robot that crosses it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum FenceAction {
    /// It is told of.
    Warn,
    /// It is told of, and the robot is stopped.
    Stop,
}

impl FenceAction {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Warn, Self::Stop];

    /// The name in messages, records and metrics.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Warn => "warn",
            Self::Stop => "stop",
        }
    }
}

/// A fence.
#[derive(Debug, Clone, PartialEq)]
pub struct Fence {
    /// In the records and in the API.
    pub id: String,
    /// For people.
    pub name: String,
    /// Which side of it is the wrong one.
    pub kind: FenceKind,
    /// What happens to a robot that crosses it.
    pub action: FenceAction,
    /// Where it is.
    pub shape: Shape,
    /// Who made it.
    pub by: String,
    /// Unix milliseconds.
    pub made_at: i64,
}

impl Fence {
    /// Whether a robot at `at` is on the wrong side; `was` says whether it was before.
    pub fn is_violated(&self, at: [f64; 2], was: bool) -> bool {
        let shape = &self.shape;
        match self.kind {
            FenceKind::KeepIn if !shape.holds(at) => true,
            // In a narrow one it is back where there is still a place to be.
            FenceKind::KeepIn => was && shape.to_edge(at) < HYSTERESIS.min(shape.depth() / 2.0),
            FenceKind::KeepOut if !shape.is_near(at, HYSTERESIS) => false,
            FenceKind::KeepOut => shape.holds(at) || (was && shape.to_edge(at) < HYSTERESIS),
        }
    }

    /// What a robot did that crossed it; `back` to where it should be.
    pub const fn crossing_verb(&self, back: bool) -> &'static str {
        match (self.kind, back) {
            (FenceKind::KeepIn, false) => "left",
            (FenceKind::KeepIn, true) => "came back into",
            (FenceKind::KeepOut, false) => "entered",
            (FenceKind::KeepOut, true) => "came out of",
        }
    }

    /// As it is kept.
    pub fn to_kept(&self) -> KeptFence {
        KeptFence {
            id: self.id.clone(),
            name: self.name.clone(),
            kind: self.kind.name().to_owned(),
            action: self.action.name().to_owned(),
            // Finite numbers, which JSON can write.
            corners: json!(self.shape.corners()).to_string(),
            by: self.by.clone(),
            made_at: self.made_at,
        }
    }

    /// From how it is kept; `None` for what this program could not have kept.
    pub fn of_kept(kept: KeptFence) -> Option<Self> {
        let corners = serde_json::from_str(&kept.corners).ok()?;
        Some(Self {
            kind: FenceKind::ALL
                .into_iter()
                .find(|kind| kind.name() == kept.kind)?,
            action: FenceAction::ALL
                .into_iter()
                .find(|action| action.name() == kept.action)?,
            shape: Shape::new(corners).ok()?,
            id: kept.id,
            name: kept.name,
            by: kept.by,
            made_at: kept.made_at,
        })
    }
}
