//! Telemetry as CBOR (RFC 8949): a map with small integers as keys.
//!
//! Written in the deterministic way of section 4.2.1, but for floats, which are always single. Read as
//! strictly as JSON: a key that telemetry does not have, a key twice, another type and a value out of
//! range are errors. What is not known is left out; there is no `null`.

use minicbor::decode::{self, Decoder};
use minicbor::encode::write::{Cursor, EndOfSlice};
use minicbor::encode::{self, Encoder};

use super::{Battery, Telemetry, Wheels};
use crate::{BehaviourName, DecodeError, EncodeError, MAX_MESSAGE, Pose, RobotId, RobotState};

const ROBOT: u8 = 0;
const SEQ: u8 = 1;
const TIMESTAMP: u8 = 2;
const STATE: u8 = 3;
const BEHAVIOUR: u8 = 4;
const POSE: u8 = 5;
const RANGE_MM: u8 = 6;
const TEMPERATURE_C: u8 = 7;
const WHEELS: u8 = 8;
const BATTERY: u8 = 9;
const RSSI_DBM: u8 = 10;

/// Fields that are always there.
const REQUIRED: usize = 8;

impl Telemetry {
    /// Writes the sample as CBOR to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// As [`Telemetry::to_json`].
    pub fn to_cbor(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        let Pose { x, y, theta, sigma } = self.pose;
        let numbers = [x, y, theta, sigma, self.wheels.left, self.wheels.right];
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err(EncodeError::NotFinite);
        }
        let most = buf.len().min(MAX_MESSAGE);
        let room = buf.get_mut(..most).ok_or(EncodeError::TooLarge)?;
        let mut out = Encoder::new(Cursor::new(room));
        write(self, &mut out).map_err(|_| EncodeError::TooLarge)?;
        Ok(out.writer().position())
    }

    /// Reads a sample from the whole of `payload`, which is CBOR.
    ///
    /// # Errors
    /// [`DecodeError`] names what is wrong with `payload`.
    pub fn from_cbor(payload: &[u8]) -> Result<Self, DecodeError> {
        if payload.len() > MAX_MESSAGE {
            return Err(DecodeError::TooLarge);
        }
        let mut decoder = Decoder::new(payload);
        let telemetry = read(&mut decoder)?;
        if decoder.position() == payload.len() {
            Ok(telemetry)
        } else {
            Err(DecodeError::Malformed)
        }
    }
}

fn write(
    telemetry: &Telemetry,
    out: &mut Encoder<Cursor<&mut [u8]>>,
) -> Result<(), encode::Error<EndOfSlice>> {
    let temperature = telemetry.temperature_c.filter(|value| value.is_finite());
    let optional = [
        telemetry.range_mm.is_some(),
        temperature.is_some(),
        telemetry.rssi_dbm.is_some(),
    ];
    let fields = REQUIRED + optional.iter().filter(|there| **there).count();
    out.map(fields as u64)?;
    out.u8(ROBOT)?.str(telemetry.robot.as_str())?;
    out.u8(SEQ)?.u64(telemetry.seq)?;
    out.u8(TIMESTAMP)?.u64(telemetry.timestamp)?;
    out.u8(STATE)?.u8(telemetry.state as u8)?;
    out.u8(BEHAVIOUR)?.u8(telemetry.behaviour as u8)?;
    let Pose { x, y, theta, sigma } = telemetry.pose;
    out.u8(POSE)?
        .array(4)?
        .f32(x)?
        .f32(y)?
        .f32(theta)?
        .f32(sigma)?;
    if let Some(range) = telemetry.range_mm {
        out.u8(RANGE_MM)?.u16(range)?;
    }
    if let Some(temperature) = temperature {
        out.u8(TEMPERATURE_C)?.f32(temperature)?;
    }
    let Wheels { left, right } = telemetry.wheels;
    out.u8(WHEELS)?.array(2)?.f32(left)?.f32(right)?;
    let Battery { mv, percent } = telemetry.battery;
    out.u8(BATTERY)?.array(2)?.u16(mv)?.u8(percent)?;
    if let Some(rssi) = telemetry.rssi_dbm {
        out.u8(RSSI_DBM)?.i8(rssi)?;
    }
    Ok(())
}

/// What has been read of a sample.
#[derive(Default)]
struct Draft {
    robot: Option<RobotId>,
    seq: Option<u64>,
    timestamp: Option<u64>,
    state: Option<RobotState>,
    behaviour: Option<BehaviourName>,
    pose: Option<Pose>,
    range_mm: Option<u16>,
    temperature_c: Option<f32>,
    wheels: Option<Wheels>,
    battery: Option<Battery>,
    rssi_dbm: Option<i8>,
}

/// Reads one sample; others may follow.
pub(super) fn read(decoder: &mut Decoder<'_>) -> Result<Telemetry, DecodeError> {
    let fields = decoder.map().map_err(|error| describe(&error))?;
    let mut draft = Draft::default();
    // As many rounds as there are bytes at most, whatever the head says: the next one fails.
    for _ in 0..fields.ok_or(DecodeError::WrongType)? {
        match key(decoder)? {
            ROBOT => once(&mut draft.robot, robot(decoder)?),
            SEQ => once(&mut draft.seq, is(decoder.u64())?),
            TIMESTAMP => once(&mut draft.timestamp, is(decoder.u64())?),
            STATE => once(&mut draft.state, word(RobotState::ALL, decoder)?),
            BEHAVIOUR => once(&mut draft.behaviour, word(BehaviourName::ALL, decoder)?),
            POSE => {
                let [x, y, theta, sigma] = numbers(decoder)?;
                once(&mut draft.pose, Pose { x, y, theta, sigma })
            }
            RANGE_MM => once(&mut draft.range_mm, is(decoder.u16())?),
            TEMPERATURE_C => once(&mut draft.temperature_c, number(decoder)?),
            WHEELS => {
                let [left, right] = numbers(decoder)?;
                once(&mut draft.wheels, Wheels { left, right })
            }
            BATTERY => once(&mut draft.battery, battery(decoder)?),
            RSSI_DBM => once(&mut draft.rssi_dbm, is(decoder.i8())?),
            _ => Err(DecodeError::UnknownField),
        }?;
    }
    Ok(Telemetry {
        robot: there(draft.robot)?,
        seq: there(draft.seq)?,
        timestamp: there(draft.timestamp)?,
        state: there(draft.state)?,
        behaviour: there(draft.behaviour)?,
        pose: there(draft.pose)?,
        range_mm: draft.range_mm,
        temperature_c: draft.temperature_c,
        wheels: there(draft.wheels)?,
        battery: there(draft.battery)?,
        rssi_dbm: draft.rssi_dbm,
    })
}

fn describe(error: &decode::Error) -> DecodeError {
    if error.is_end_of_input() {
        DecodeError::Malformed
    } else if error.is_type_mismatch() {
        DecodeError::WrongType
    } else {
        // An integer too large for its field.
        DecodeError::OutOfRange
    }
}

fn is<T>(read: Result<T, decode::Error>) -> Result<T, DecodeError> {
    read.map_err(|error| describe(&error))
}

fn once<T>(field: &mut Option<T>, value: T) -> Result<(), DecodeError> {
    match field.replace(value) {
        None => Ok(()),
        Some(_) => Err(DecodeError::DuplicateField),
    }
}

fn there<T>(field: Option<T>) -> Result<T, DecodeError> {
    field.ok_or(DecodeError::MissingField)
}

fn key(decoder: &mut Decoder<'_>) -> Result<u8, DecodeError> {
    decoder.u8().map_err(|error| match describe(&error) {
        DecodeError::Malformed => DecodeError::Malformed,
        _ => DecodeError::UnknownField,
    })
}

fn robot(decoder: &mut Decoder<'_>) -> Result<RobotId, DecodeError> {
    let text = decoder.str().map_err(|error| match describe(&error) {
        DecodeError::WrongType => DecodeError::WrongType,
        // Cut off, or not UTF-8.
        _ => DecodeError::Malformed,
    })?;
    RobotId::new(text).map_err(|_| DecodeError::OutOfRange)
}

fn word<T: Copy>(all: &[T], decoder: &mut Decoder<'_>) -> Result<T, DecodeError> {
    let place = usize::from(is(decoder.u8())?);
    all.get(place).copied().ok_or(DecodeError::OutOfRange)
}

fn number(decoder: &mut Decoder<'_>) -> Result<f32, DecodeError> {
    let value = is(decoder.f32())?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(DecodeError::OutOfRange)
    }
}

fn numbers<const N: usize>(decoder: &mut Decoder<'_>) -> Result<[f32; N], DecodeError> {
    array(decoder, N)?;
    let mut values = [0.0; N];
    for value in &mut values {
        *value = number(decoder)?;
    }
    Ok(values)
}

fn battery(decoder: &mut Decoder<'_>) -> Result<Battery, DecodeError> {
    array(decoder, 2)?;
    let mv = is(decoder.u16())?;
    let percent = is(decoder.u8())?;
    if percent <= 100 {
        Ok(Battery { mv, percent })
    } else {
        Err(DecodeError::OutOfRange)
    }
}

fn array(decoder: &mut Decoder<'_>, length: usize) -> Result<(), DecodeError> {
    match is(decoder.array())? {
        Some(told) if told == length as u64 => Ok(()),
        _ => Err(DecodeError::WrongType),
    }
}
