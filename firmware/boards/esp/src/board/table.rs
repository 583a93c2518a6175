//! The form of a board's pin table.
//!
//! A table is one invocation of `pin_table!`. For the chip it becomes types, so that a pin has one
//! owner; a test on the host reads the same files with a macro of its own and holds them to the
//! documentation and to the rules for strapping pins.

/// A board: its pins by what hangs on them, and everything else of the chip that is used.
///
/// Pins are named as the board's schematic names them, with the GPIO behind. A GPIO that is named
/// twice is moved out of the peripherals twice, which does not compile.
macro_rules! pin_table {
    (
        name: $name:literal,
        id: $id:literal,
        lamp: lit $lit:ident,
        battery: $battery:ident,
        divider: $top:literal over $bottom:literal, converter ends at $limit:literal,
        strapping: [$($strapping:literal),*],
        usb: [$($usb:literal),*],
        console: [$($console:literal),*],
        $(
            $(#[$about:meta])*
            $group:ident as $field:ident {
                $($role:ident: $schematic:literal = $gpio:ident, $number:literal, $what:literal;)*
            }
        )*
    ) => {
        use esp_hal::peripherals::{self, Peripherals};

        /// Name of the board in what the robot reports.
        pub(crate) const ID: &str = $id;
        /// Level that lights the lamp.
        pub(crate) const LAMP_LIT: esp_hal::gpio::Level = esp_hal::gpio::Level::$lit;
        /// The pin of the battery, which the converter wants to know by type.
        pub(crate) type BatteryPin = peripherals::$battery<'static>;
        /// The battery's divider, checked against what the converter can tell.
        pub(crate) const DIVIDER: crawler_drivers::battery::Divider =
            match crawler_drivers::battery::Divider::new(
                $top,
                $bottom,
                crawler_hal::Millivolts($limit),
            ) {
                Ok(divider) => divider,
                Err(_) => panic!("the divider does not fit the converter"),
            };
        /// What the converter can tell at most, in millivolts.
        pub(crate) const CONVERTER_LIMIT_MV: u16 = $limit;

        $(
            $(#[$about])*
            pub(crate) struct $group {
                $(
                    #[doc = $what]
                    pub(crate) $role: peripherals::$gpio<'static>,
                )*
            }
        )*

        /// The board in parts.
        pub(crate) struct Board {
            $(
                $(#[$about])*
                pub(crate) $field: $group,
            )*
            /// What is used of the chip besides its pins.
            pub(crate) chip: super::Chip,
        }

        impl Board {
            /// Takes the chip apart.
            pub(crate) fn new(p: Peripherals) -> Self {
                $(
                    let $field = $group {
                        $($role: p.$gpio,)*
                    };
                )*
                Self {
                    $($field,)*
                    chip: super::chip!(p),
                }
            }
        }

        /// Pins that drive the L298N, by number.
        pub(crate) const MOTOR_PINS: [u8; 6] = super::motor_pins(&[
            $($((stringify!($role), $number),)*)*
        ]);

        // The numbers are those of the types.
        $($(
            const _: () = assert!(
                super::gpio_number(stringify!($gpio)) == $number,
                concat!(stringify!($gpio), " and its number differ"),
            );
        )*)*
    };
}
