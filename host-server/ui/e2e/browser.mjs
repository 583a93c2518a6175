// Starts the system's Chromium with a fresh profile.

import { chromium } from 'playwright-core'

/** A browser; `CHROMIUM` names another executable than Debian's. */
export function launch() {
  return chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    headless: true,
    args: [
      '--no-sandbox',
      '--disable-gpu',
      '--disable-quic',
      '--no-first-run',
      '--disable-background-networking',
      '--disable-component-update',
      '--disable-sync',
      // WebGL on the processor: test machines have no graphics card.
      '--use-angle=swiftshader',
      '--enable-unsafe-swiftshader',
    ],
  })
}

export const DESKTOP = { width: 1440, height: 900 }
export const PHONE = { width: 390, height: 844 }
export const WALL = { width: 2560, height: 1440 }
