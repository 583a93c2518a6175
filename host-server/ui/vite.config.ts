import vue from '@vitejs/plugin-vue'
import { defineConfig } from 'vitest/config'

/** The server that `npm run dev` passes API calls and the live feed on to. */
const backend = process.env['BACKEND'] ?? 'http://127.0.0.1:8080'

export default defineConfig({
  plugins: [vue()],
  build: {
    target: 'es2022',
    // Every asset is a file of its own, so that a strict content security
    // policy needs no `data:` sources.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
  },
  server: {
    host: '127.0.0.1',
    proxy: {
      '/api': { target: backend, ws: true },
      '/readyz': { target: backend },
      '/metrics': { target: backend },
    },
  },
  test: {
    include: ['tests/unit/**/*.test.ts'],
    restoreMocks: true,
    // Builds run beside them.
    testTimeout: 120_000,
    // One test reads the style sheet.
    css: true,
  },
})
