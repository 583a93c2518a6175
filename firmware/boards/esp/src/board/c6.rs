//! XIAO ESP32C6: 4 MB flash, and a switch between two antennas.
//!
//! Source: Seeed Studio, schematic and pin list of XIAO ESP32C6. Strapping and USB pins: ESP32-C6
//! data sheet, sections "Strapping Pins" and "USB Serial/JTAG".

pin_table! {
    name: "XIAO ESP32C6",
    id: "xiao-c6",
    // The LED hangs between 3.3 V and the pin.
    lamp: lit Low,
    battery: GPIO0,
    divider: 100_000 over 47_000, converter ends at 3_100,
    strapping: [4, 5, 8, 9, 15],
    usb: [12, 13],
    console: [16],

    /// What hangs on the pins of the robot.
    RobotPins as robot {
        battery: "D0" = GPIO0, 0, "middle of the battery divider";
        left_in1: "D1" = GPIO1, 1, "IN1 of the L298N";
        left_in2: "D2" = GPIO2, 2, "IN2 of the L298N";
        left_enable: "D3" = GPIO21, 21, "ENA of the L298N";
        right_enable: "D4" = GPIO22, 22, "ENB of the L298N";
        right_in1: "D5" = GPIO23, 23, "IN3 of the L298N";
        ranger_tx: "D6" = GPIO16, 16, "Trig/TX of the US-100";
        ranger_rx: "D7" = GPIO17, 17, "Echo/RX of the US-100";
        right_in2: "D8" = GPIO19, 19, "IN4 of the L298N";
        lamp: "USER_LED" = GPIO15, 15, "status lamp, on the board";
        button: "BOOT" = GPIO9, 9, "held at boot: provisioning; on the board";
    }

    /// The switch between the antennas.
    AntennaPins as antenna {
        power: "WIFI_ENABLE" = GPIO3, 3, "low: the switch has power";
        select: "WIFI_ANT_CONFIG" = GPIO14, 14, "low: antenna on the board; high: connector";
    }
}
