// Releases of the mock: some of every kind. It verifies nothing, and so takes none.

import { Refusal } from './accounts.mjs'

const DAY_MS = 86_400_000

export function createReleases({ clock }) {
  const now = clock()
  const release = (number, more = {}) => ({
    id: number.toString(16).padStart(16, '0'),
    kind: 'program',
    name: null,
    board: 'xiao-c3',
    version: `0.${number}.0`,
    build: `9f2c1ab${number}`,
    sequence: number,
    floor: 3,
    expires_at: now + 90 * DAY_MS,
    size: 608_100,
    by: 'ada',
    added_at: now - (20 - number) * DAY_MS,
    gate: null,
    withdrawn: null,
    key: '0123456789abcdef',
    chip: 'esp32c3',
    sha256: 'e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855',
    block_size: 65_536,
    blocks: 10,
    delta: null,
    requires: { sequence: 0, protocol: 0 },
    ...more,
  })
  const releases = [
    release(12),
    release(11, { withdrawn: { by: 'ada', at: now - DAY_MS, reason: 'it drives into walls' } }),
    release(10, { expires_at: now - DAY_MS, requires: { sequence: 9, protocol: 1 } }),
    release(7, { kind: 'model', name: 'eyes', board: 'xiao-s3-sense', expires_at: null }),
    release(8),
    release(9, { board: 'virt' }),
    // The way back to the one before, ready to go out.
    release(13, { version: '0.8.0', build: '9f2c1ab8' }),
  ]

  /** Status and body of an answer; `null` for what is about something else. */
  function answer(method, parts, body, by) {
    if (parts[0] !== 'releases') return null
    if (parts.length === 1) {
      if (method === 'GET') return { status: 200, body: { releases, next: null, can_add: true } }
      const text = 'the signature is wrong'
      const faults = [{ code: 'bad_signature', text }]
      const said = { title: 'Unprocessable Content', detail: `bad_signature: ${text}`, faults }
      return { status: 422, body: { ...said, status: 422, code: 'invalid_release' } }
    }
    const found = releases.find(({ id }) => id === parts[1])
    if (found === undefined) throw new Refusal(404, 'unknown_release', 'there is no such release')
    if (parts[2] === 'withdraw') {
      if (found.withdrawn !== null) throw new Refusal(409, 'wrong_state', 'it was withdrawn before')
      found.withdrawn = { by, at: clock(), reason: body.reason }
    }
    return { status: 200, body: found }
  }

  return { answer, releases }
}
