//! XIAO ESP32S3 Sense: the camera board with 8 MB flash.
//!
//! Source: Seeed Studio, schematics of XIAO ESP32S3 and of the Sense expansion board; pin lists of
//! the product page. Strapping and USB pins: ESP32-S3 data sheet, sections "Strapping Pins" and
//! "USB Serial/JTAG".

pin_table! {
    name: "XIAO ESP32S3 Sense",
    id: "xiao-s3-sense",
    // USER_LED hangs between 3.3 V and the pin. The pin also selects the SD card.
    lamp: lit Low,
    battery: GPIO1,
    divider: 100_000 over 47_000, converter ends at 3_100,
    strapping: [0, 3, 45, 46],
    usb: [19, 20],
    console: [43],

    /// What hangs on the pins of the robot.
    RobotPins as robot {
        battery: "D0" = GPIO1, 1, "middle of the battery divider";
        left_in1: "D1" = GPIO2, 2, "IN1 of the L298N";
        left_in2: "D3" = GPIO4, 4, "IN2 of the L298N";
        right_in1: "D4" = GPIO5, 5, "IN3 of the L298N";
        right_in2: "D5" = GPIO6, 6, "IN4 of the L298N";
        ranger_tx: "D6" = GPIO43, 43, "Trig/TX of the US-100";
        ranger_rx: "D7" = GPIO44, 44, "Echo/RX of the US-100";
        left_enable: "D8" = GPIO7, 7, "ENA of the L298N";
        right_enable: "D9" = GPIO8, 8, "ENB of the L298N";
        lamp: "USER_LED" = GPIO21, 21, "status lamp, on the board";
        button: "BOOT" = GPIO0, 0, "held at boot: provisioning; on the board";
    }

    /// What the ribbon of the camera carries.
    CameraPins as camera {
        clock: "XMCLK" = GPIO10, 10, "clock to the sensor";
        pixel_clock: "DVP_PCLK" = GPIO13, 13, "clock of the pixels";
        vsync: "DVP_VSYNC" = GPIO38, 38, "start of a frame";
        href: "DVP_HREF" = GPIO47, 47, "pixels of a line";
        y2: "DVP_Y2" = GPIO15, 15, "data bit 0";
        y3: "DVP_Y3" = GPIO17, 17, "data bit 1";
        y4: "DVP_Y4" = GPIO18, 18, "data bit 2";
        y5: "DVP_Y5" = GPIO16, 16, "data bit 3";
        y6: "DVP_Y6" = GPIO14, 14, "data bit 4";
        y7: "DVP_Y7" = GPIO12, 12, "data bit 5";
        y8: "DVP_Y8" = GPIO11, 11, "data bit 6";
        y9: "DVP_Y9" = GPIO48, 48, "data bit 7";
        sda: "CAM_SDA" = GPIO40, 40, "control bus, data";
        scl: "CAM_SCL" = GPIO39, 39, "control bus, clock";
    }
}
