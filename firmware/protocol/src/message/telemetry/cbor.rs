//! Telemetry as CBOR (RFC 8949): a map with small integers as keys.
//!
//! Written in the deterministic way of section 4.2.1, but for floats, which are always single. Read as
//! strictly as JSON: a key that telemetry does not have, a key twice, another type and a value out of
//! range are errors; a tolerant reader passes over keys that it does not know, and over what an array
//! has more than it knows. What is not known is left out; there is no `null`.

use minicbor::decode::{self, Decoder};
use minicbor::encode::write::{Cursor, EndOfSlice};
use minicbor::encode::{self, Encoder};

use super::{Battery, Telemetry, Wheels};
use crate::json::{Strict, Strictness};
use crate::open::Open;
use crate::words::Words;
use crate::{
    BehaviourName, DecodeError, EncodeError, MAX_MESSAGE, MAX_SAYS, Pose, RobotId, RobotState, Says,
};

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
const SAYS: u8 = 11;

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
        read_whole(payload, &mut Strict)
    }
}

/// A word that telemetry in CBOR tells by its number.
pub(crate) trait Numbered: Sized {
    /// The word of that number.
    fn numbered(number: u8) -> Result<Self, DecodeError>;
}

/// One that is not known is none.
fn known<T: Words>(number: u8) -> Result<T, DecodeError> {
    let word = T::VALUES.get(usize::from(number));
    word.copied().ok_or(DecodeError::OutOfRange)
}

impl Numbered for RobotState {
    fn numbered(number: u8) -> Result<Self, DecodeError> {
        known(number)
    }
}

impl Numbered for BehaviourName {
    fn numbered(number: u8) -> Result<Self, DecodeError> {
        known(number)
    }
}

impl<T: Words> Numbered for Open<T> {
    fn numbered(number: u8) -> Result<Self, DecodeError> {
        Ok(known(number).map_or_else(|_| Self::of_number(number), Self::Known))
    }
}

/// Reads a sample and nothing after it.
pub(crate) fn read_whole<S: Numbered, B: Numbered>(
    payload: &[u8],
    strictness: &mut impl Strictness,
) -> Result<Telemetry<S, B>, DecodeError> {
    let mut decoder = Decoder::new(payload);
    let telemetry = read(&mut decoder, strictness)?;
    if decoder.position() == payload.len() {
        Ok(telemetry)
    } else {
        Err(DecodeError::Malformed)
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
        telemetry.says.is_some(),
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
    if let Some(says) = telemetry.says {
        let numbers = says.numbers();
        out.u8(SAYS)?.array(numbers.len() as u64)?;
        for number in numbers {
            out.i32(*number)?;
        }
    }
    Ok(())
}

/// What has been read of a sample.
struct Draft<S, B> {
    robot: Option<RobotId>,
    seq: Option<u64>,
    timestamp: Option<u64>,
    state: Option<S>,
    behaviour: Option<B>,
    pose: Option<Pose>,
    range_mm: Option<u16>,
    temperature_c: Option<f32>,
    wheels: Option<Wheels>,
    battery: Option<Battery>,
    rssi_dbm: Option<i8>,
    says: Option<Says>,
}

/// Reads one sample; others may follow.
pub(crate) fn read<S: Numbered, B: Numbered, F: Strictness>(
    decoder: &mut Decoder<'_>,
    strictness: &mut F,
) -> Result<Telemetry<S, B>, DecodeError> {
    let fields = decoder.map().map_err(|error| describe(&error))?;
    let mut draft = Draft {
        robot: None,
        seq: None,
        timestamp: None,
        state: None,
        behaviour: None,
        pose: None,
        range_mm: None,
        temperature_c: None,
        wheels: None,
        battery: None,
        rssi_dbm: None,
        says: None,
    };
    // As many rounds as there are bytes at most, whatever the head says: the next one fails.
    for _ in 0..fields.ok_or(DecodeError::WrongType)? {
        let begun = decoder.position();
        match key(decoder) {
            Ok(ROBOT) => once(&mut draft.robot, robot(decoder)?),
            Ok(SEQ) => once(&mut draft.seq, is(decoder.u64())?),
            Ok(TIMESTAMP) => once(&mut draft.timestamp, is(decoder.u64())?),
            Ok(STATE) => once(&mut draft.state, S::numbered(is(decoder.u8())?)?),
            Ok(BEHAVIOUR) => once(&mut draft.behaviour, B::numbered(is(decoder.u8())?)?),
            Ok(POSE) => {
                let [x, y, theta, sigma] = numbers(decoder, strictness)?;
                once(&mut draft.pose, Pose { x, y, theta, sigma })
            }
            Ok(RANGE_MM) => once(&mut draft.range_mm, is(decoder.u16())?),
            Ok(TEMPERATURE_C) => once(&mut draft.temperature_c, number(decoder)?),
            Ok(WHEELS) => {
                let [left, right] = numbers(decoder, strictness)?;
                once(&mut draft.wheels, Wheels { left, right })
            }
            Ok(BATTERY) => once(&mut draft.battery, battery(decoder, strictness)?),
            Ok(RSSI_DBM) => once(&mut draft.rssi_dbm, is(decoder.i8())?),
            Ok(SAYS) => once(&mut draft.says, says(decoder)?),
            Ok(_) | Err(DecodeError::UnknownField) if F::TOLERANT => {
                decoder.set_position(begun);
                pass_over(decoder, 2)?;
                strictness.passed_over();
                Ok(())
            }
            Ok(_) => Err(DecodeError::UnknownField),
            Err(error) => Err(error),
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
        says: draft.says,
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

/// Passes over so many values, however deep they are. What takes part in an indefinite length, which
/// robots do not write, may not be passed over, and is malformed.
fn pass_over(decoder: &mut Decoder<'_>, values: usize) -> Result<(), DecodeError> {
    for _ in 0..values {
        decoder.skip().map_err(|_| DecodeError::Malformed)?;
    }
    Ok(())
}

fn number(decoder: &mut Decoder<'_>) -> Result<f32, DecodeError> {
    let value = is(decoder.f32())?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(DecodeError::OutOfRange)
    }
}

fn numbers<const N: usize>(
    decoder: &mut Decoder<'_>,
    strictness: &mut impl Strictness,
) -> Result<[f32; N], DecodeError> {
    let more = array(decoder, N, strictness)?;
    let mut values = [0.0; N];
    for value in &mut values {
        *value = number(decoder)?;
    }
    pass_over(decoder, more)?;
    Ok(values)
}

fn battery(
    decoder: &mut Decoder<'_>,
    strictness: &mut impl Strictness,
) -> Result<Battery, DecodeError> {
    let more = array(decoder, 2, strictness)?;
    let mv = is(decoder.u16())?;
    let percent = is(decoder.u8())?;
    pass_over(decoder, more)?;
    if percent <= 100 {
        Ok(Battery { mv, percent })
    } else {
        Err(DecodeError::OutOfRange)
    }
}

/// From one number to as many as may be said.
fn says(decoder: &mut Decoder<'_>) -> Result<Says, DecodeError> {
    let told = is(decoder.array())?.ok_or(DecodeError::WrongType)?;
    let told = usize::try_from(told).unwrap_or(usize::MAX);
    let mut numbers = [0; MAX_SAYS];
    let numbers = numbers.get_mut(..told).ok_or(DecodeError::OutOfRange)?;
    for number in &mut *numbers {
        *number = is(decoder.i32())?;
    }
    Says::of_numbers(numbers).ok_or(DecodeError::OutOfRange)
}

/// Enters an array of `length` values, and says how many more it has, each of which is an unknown
/// field.
fn array<F: Strictness>(
    decoder: &mut Decoder<'_>,
    length: usize,
    strictness: &mut F,
) -> Result<usize, DecodeError> {
    let told = is(decoder.array())?.and_then(|told| usize::try_from(told).ok());
    match told {
        Some(told) if told == length => Ok(0),
        // None of them takes less than a byte.
        Some(told) if F::TOLERANT && told > length && told <= MAX_MESSAGE => {
            for _ in length..told {
                strictness.passed_over();
            }
            Ok(told - length)
        }
        _ => Err(DecodeError::WrongType),
    }
}
