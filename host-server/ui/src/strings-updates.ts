/** Words of the page about updates; loaded with it. */

import type { Release } from './api-types'
import type { Gate, Standing } from './updates/releases'

const number = (value: number): string => value.toLocaleString('en')

export const standings: Record<Standing, string> = {
  good: 'Available',
  expired: 'Expired',
  withdrawn: 'Withdrawn',
}

export function kindOf({ kind, name }: Pick<Release, 'kind' | 'name'>): string {
  if (kind === 'program') return 'Program'
  return name == null ? 'Model' : `Model ${name}`
}

export const list = {
  title: 'Releases',
  lead: 'A release is a program or a model for one board, signed with a key of yours. The server keeps those that it can verify.',
  columns: ['Release', 'Board', 'Sequence', 'State', 'Added'],
  empty: 'No release yet.',
  emptyMore: 'Sign one with terracrawler release sign, and add its file here.',
  by: (when: string, who: string) => `${when} by ${who}`,
  older: 'Older releases',
}

export const add = {
  title: 'Add a release',
  file: 'File that terracrawler release sign has made',
  submit: 'Add the release',
  busy: 'Adding…',
  none: 'Choose a file.',
  large: 'This is no release: it is larger than any can be.',
  done: (id: string) => `Release ${id} is added.`,
  refused: 'The release is refused:',
  failed: (why: string) => `The release is not added: ${why}.`,
  noKeys: 'This server knows no public key, and so takes no releases.',
  noKeysMore: 'Start it with --release-key FILE, the public key that release keygen has made.',
  admin: 'Adding and withdrawing releases needs the role admin.',
}

export const one = {
  back: 'All releases',
  unknown: 'There is no release of this id.',
  facts: 'What the manifest says',
  fact: {
    id: 'Id',
    kind: 'Kind',
    board: 'Board',
    chip: 'Chip',
    version: 'Version',
    build: 'Build',
    sequence: 'Sequence',
    floor: 'Floor',
    expires: 'Expires',
    size: 'Image',
    sha256: 'SHA-256',
    requires: 'Requires',
    delta: 'Delta',
    key: 'Signed with',
    gate: 'Gate',
  },
  gates: {
    passed: 'passed',
    failed: 'did not pass: a rollout takes it only with a reason',
    none: 'none: a rollout takes it only with a reason, but for simulated robots',
  } satisfies Record<Gate, string>,
  never: 'never',
  bytes: (size: number, blocks: number, block: number) =>
    `${number(size)} bytes in ${number(blocks)} ${blocks === 1 ? 'block' : 'blocks'} of ${number(block / 1_024)} KiB`,
  nothing: 'nothing',
  requires: (sequence: number, protocol: number) =>
    [
      sequence > 0 ? `sequence ${number(sequence)} or later` : '',
      protocol > 0 ? `protocol ${String(protocol)} or later` : '',
    ]
      .filter((part) => part !== '')
      .join(', '),
  delta: (size: number, build: string) => `${number(size)} bytes from build ${build}`,
  noDelta: 'none',
  withdrawn: (when: string, who: string, why: string) => `Withdrawn on ${when} by ${who}: ${why}`,
  withdraw: {
    title: 'Withdraw this release',
    lead: 'Robots are given it no more, its image is deleted, and it cannot be added again. Robots that run it go on running it.',
    reason: 'Reason, for everybody who looks',
    missing: 'Say why, in 1 to 512 bytes.',
    submit: 'Withdraw',
    question: (version: string, board: string) =>
      `Withdraw ${version} for ${board}? This cannot be undone.`,
    done: 'The release is withdrawn.',
    failed: (why: string) => `Not withdrawn: ${why}.`,
  },
}
