//! Registers of the OV2640, and what they are set to.
//!
//! Two banks share the addresses; register 0xFF chooses. Names, bits and defaults are those of the
//! data sheet 1.6, table 12 for the DSP bank and table 13 for the sensor bank. Values are composed
//! here from the meaning of their bits. Where the data sheet leaves a choice, the line says why.

/// Seven-bit address: 0x60 and 0x61 on the bus as the data sheet writes it.
pub const ADDRESS: u8 = 0x30;

/// Bank select, in both banks.
pub const BANK: u8 = 0xFF;
/// The DSP's registers.
pub const BANK_DSP: u8 = 0x00;
/// The sensor's registers.
pub const BANK_SENSOR: u8 = 0x01;

/// Sensor bank: product number, high byte.
pub const PIDH: u8 = 0x0A;
/// Sensor bank: product number, low byte: the version.
pub const PIDL: u8 = 0x0B;
/// What [`PIDH`] reads.
pub const PRODUCT: u8 = 0x26;
/// Sensor bank: reset, resolution.
pub const COM7: u8 = 0x12;
/// Resets all registers.
pub const COM7_RESET: u8 = 0x80;

/// One value for one register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Write(pub u8, pub u8);

/// What the sensor is to deliver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Stills.
    Jpeg,
    /// Frames as Y U Y V, of which Y is the grey.
    Grey,
    /// Frames in colour.
    Rgb565,
}

/// Which part of the sensor's picture becomes how large an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// Left edge of the part, in pixels of the sensor.
    pub x: u16,
    /// Upper edge of the part.
    pub y: u16,
    /// Width of the part; a multiple of 4.
    pub width: u16,
    /// Height of the part; a multiple of 4.
    pub height: u16,
    /// Width of the output; a multiple of 4 and not above that of the part.
    pub out_width: u16,
    /// Height of the output.
    pub out_height: u16,
}

/// What the sensor delivers in CIF mode, in pixels (data sheet: 400 × 296).
pub const CIF: (u16, u16) = (400, 296);

impl Window {
    /// The middle of the picture in the proportions of a still: 384 × 288 are 4 to 3.
    pub const STILL: Self = Self {
        x: 8,
        y: 4,
        width: 384,
        height: 288,
        out_width: 320,
        out_height: 240,
    };

    /// The square in the middle, three pixels to one.
    pub const FRAME: Self = Self {
        x: 56,
        y: 4,
        width: 288,
        height: 288,
        out_width: 96,
        out_height: 96,
    };

    /// Whether the DSP can do it.
    #[must_use]
    pub const fn is_possible(&self) -> bool {
        let whole = self.width.is_multiple_of(4)
            && self.height.is_multiple_of(4)
            && self.out_width.is_multiple_of(4)
            && self.out_height.is_multiple_of(4);
        let inside = self.x as u32 + self.width as u32 <= CIF.0 as u32
            && self.y as u32 + self.height as u32 <= CIF.1 as u32;
        let shrinks = self.out_width <= self.width && self.out_height <= self.height;
        whole && inside && shrinks && self.out_width > 0 && self.out_height > 0
    }

    /// Registers 0x51–0x57 and 0x5A–0x5C of the DSP bank: sizes are in units of four pixels,
    /// their upper bits gathered in VHYX, TEST and ZMHH.
    #[must_use]
    pub const fn registers(&self) -> [Write; 9] {
        let (h, v) = (self.width / 4, self.height / 4);
        let (out_w, out_h) = (self.out_width / 4, self.out_height / 4);
        let vhyx = ((v >> 8) & 1) << 7
            | ((self.y >> 8) & 7) << 4
            | ((h >> 8) & 1) << 3
            | ((self.x >> 8) & 7);
        [
            Write(0x51, h as u8),
            Write(0x52, v as u8),
            Write(0x53, self.x as u8),
            Write(0x54, self.y as u8),
            Write(0x55, vhyx as u8),
            Write(0x57, (((h >> 9) & 1) << 7) as u8),
            Write(0x5A, out_w as u8),
            Write(0x5B, out_h as u8),
            Write(0x5C, (((out_h >> 8) & 1) << 2 | ((out_w >> 8) & 3)) as u8),
        ]
    }
}

const _: () = assert!(Window::STILL.is_possible() && Window::FRAME.is_possible());

/// What all modes share: the sensor in CIF mode under automatic exposure and gain, and the DSP's
/// corrections switched on.
const COMMON: [Write; 21] = [
    Write(BANK, BANK_SENSOR),
    // CLKRC: no doubling, divide by 1 + 1. With 20 MHz from the board about 25 frames a second:
    // half of what is possible, for twice the exposure.
    Write(0x11, 0x01),
    // COM7: CIF.
    Write(COM7, 0x20),
    // The window of the array for CIF, as table 13 gives it: HREFST, HREFEND, VSTRT, VEND,
    // the low bits in REG32 (with the pixel clock halved, bits 7:6) and COM1.
    Write(0x17, 0x11),
    Write(0x18, 0x43),
    Write(0x19, 0x00),
    Write(0x1A, 0x25),
    Write(0x32, 0x89),
    Write(0x03, 0x0A),
    // COM2: more drive than after reset, for the ribbon.
    Write(0x09, 0x02),
    // COM8: banding filter, automatic gain, automatic exposure; bits 7:6 are to stay 1.
    Write(0x13, 0xC0 | 0x20 | 0x04 | 0x01),
    // COM10: HREF and VSYNC high when active, data changes at the falling edge of PCLK.
    Write(0x15, 0x00),
    Write(BANK, BANK_DSP),
    // HSIZE8, VSIZE8, SIZEL: what the sensor sends to the DSP, in eights and the rest.
    Write(0xC0, (CIF.0 / 8) as u8),
    Write(0xC1, (CIF.1 / 8) as u8),
    Write(0x8C, (((CIF.0 % 8) << 3) | (CIF.1 % 8)) as u8),
    // CTRL2: down-sampling, special effects off the path but enabled for UV, colour matrix.
    Write(0x86, 0x20 | 0x10 | 0x08 | 0x04 | 0x01),
    // CTRL3: black and white pixel cancelling.
    Write(0x87, 0x80 | 0x40),
    // CTRL1: colour interpolation, dummy lines, gamma, gain, white balance, lens correction, and
    // the stage before them.
    Write(0xC3, 0xFF),
    // R_DVP_SP: PCLK is the DSP's clock of 48 MHz by 8. 6 MHz carry a frame in 3 ms.
    Write(0xD3, 0x08),
    // R_BYPASS: through the DSP.
    Write(0x05, 0x00),
];

/// DSP bank.
const RESET: u8 = 0xE0;
const RESET_JPEG: u8 = 0x10;
const RESET_DVP: u8 = 0x04;
/// DSP bank: quantization scale of JPEG; smaller is better and larger. 12 gives 6 to 14 KB for a
/// still.
const QS: Write = Write(0x44, 12);
/// DSP bank: what formats the DSP makes.
const CTRL0: u8 = 0xC2;
const CTRL0_YUV: u8 = 0x08 | 0x04;
const CTRL0_RGB: u8 = 0x02;
/// DSP bank: what goes out.
const IMAGE_MODE: u8 = 0xDA;
const IMAGE_JPEG: u8 = 0x10;
/// Y U Y V, low byte first.
const IMAGE_YUYV: u8 = 0x00;
/// High byte first.
const IMAGE_RGB565: u8 = 0x08;

/// Registers after a reset, in order.
pub fn common() -> impl Iterator<Item = Write> {
    COMMON.into_iter()
}

/// Registers for a mode, in order. Formatter and JPEG encoder are held in reset meanwhile, so no
/// frame is half of one mode and half of another.
pub fn mode(mode: Mode) -> impl Iterator<Item = Write> {
    let (window, ctrl0, image) = match mode {
        Mode::Jpeg => (Window::STILL, CTRL0_YUV, IMAGE_JPEG),
        Mode::Grey => (Window::FRAME, CTRL0_YUV, IMAGE_YUYV),
        Mode::Rgb565 => (Window::FRAME, CTRL0_YUV | CTRL0_RGB, IMAGE_RGB565),
    };
    let before = [
        Write(BANK, BANK_DSP),
        Write(RESET, RESET_JPEG | RESET_DVP),
        Write(CTRL0, ctrl0),
        Write(IMAGE_MODE, image),
        QS,
    ];
    before
        .into_iter()
        .chain(window.registers())
        .chain([Write(RESET, 0x00)])
}
