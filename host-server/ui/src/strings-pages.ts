/** Words of the pages for accounts, keys and the audit log; loaded with them. */

import type { Role } from './account/roles'
import type { Page } from './view'

export const pages: Record<Page, string> = {
  account: 'You',
  people: 'People',
  keys: 'Robot keys',
  audit: 'Audit log',
}

export const words = {
  nav: 'Account and administration',
  loading: 'Loading…',
  failed: (why: string) => `This could not be loaded: ${why}.`,
  retry: 'Try again',
  notDone: (why: string) => `Not done: ${why}.`,
  cancel: 'Cancel',
  never: '–',

  copy: {
    copy: 'Copy',
    copied: 'Copied',
    byHand: 'Select the text and copy it by hand.',
  },

  account: {
    lead: (name: string) => `Logged in as ${name}`,
    may: {
      viewer: 'You may watch robots and read their history. Commands need the role operator.',
      operator: 'You may watch and command robots, and stop them all.',
      admin: 'You may do everything: command robots, and manage people and keys.',
    } satisfies Record<Role, string>,
    logOut: 'Log out',
    loggingOut: 'Logging out…',
    change: 'Change the password',
    changeHint: 'Your other sessions end when you do.',
    old: 'Old password',
    missingOld: 'Enter the password you have now.',
    wrongOld: 'The old password is wrong.',
    save: 'Change the password',
    saving: 'Changing…',
    changed: 'The password is changed. Your other sessions have ended.',
    sessions: 'Where you are logged in',
    current: 'this session',
    opened: (when: string) => `since ${when}`,
    seen: (when: string) => `last seen ${when}`,
    end: 'End',
    endOf: (from: string) => `End the session from ${from}`,
    ended: (from: string) => `The session from ${from} has ended.`,
    unknownPlace: 'an unknown address',
    noSessions: 'No sessions.',
  },

  people: {
    count: (count: number) => (count === 1 ? '1 account' : `${String(count)} accounts`),
    add: 'Invite somebody',
    name: 'Name',
    nameHint: 'Small letters, digits, dots, dashes, underscores.',
    badName: 'This cannot be a name: a small letter first, 32 characters at most.',
    taken: 'There is an account of that name.',
    role: 'Role',
    roleOf: (name: string) => `Role of ${name}`,
    roleHint: {
      viewer: 'Watches.',
      operator: 'Watches and commands robots.',
      admin: 'Everything, people and keys too.',
    } satisfies Record<Role, string>,
    invite: 'Make an invitation',
    inviting: 'Making it…',
    link: (name: string) => `Invitation for ${name}`,
    linkLabel: 'Link',
    linkHint: 'Send it to them by a way you trust. It works once and is shown only here.',
    done: 'Done',
    columns: ['Name', 'Role', 'State', 'Since', 'Actions'],
    you: 'you',
    state: { active: 'Active', invited: 'Invited', disabled: 'Disabled' },
    disable: 'Disable',
    enable: 'Enable',
    remove: 'Remove',
    of: (act: string, name: string) => `${act} ${name}`,
    confirmRemove: (name: string) => `Remove ${name} for good? Their sessions end at once.`,
    confirmDisable: (name: string) => `Lock ${name} out? Their sessions end at once.`,
    lastAdmin: 'The last admin: make another one first.',
    yourself: 'Only another admin can change this for you.',
    changed: {
      role: (name: string, role: string) => `${name} is now ${role}.`,
      disable: (name: string) => `${name} is locked out.`,
      enable: (name: string) => `${name} may log in again.`,
      remove: (name: string) => `${name} is removed.`,
    },
    none: 'No accounts yet.',
  },

  keys: {
    lead: 'Each robot proves who it is with a key of its own. Only the key’s fingerprint is kept here.',
    add: 'Enrol a robot',
    robot: 'Robot',
    robotHint:
      'Its id, “simulator-” and a name for many simulated robots, or “learner-” and a name for a machine of federated learning.',
    badRobot: 'This cannot be an id: small letters, digits and dashes, 32 characters at most.',
    enrol: 'Make a key',
    enrolling: 'Making it…',
    replace: (robot: string) =>
      `${robot} has a key. A new one replaces it, and the robot is cut off until it has the new one.`,
    replaceIt: 'Replace the key',
    made: (robot: string) => `Key of ${robot}`,
    once: 'Shown only now. Put it into the robot, or copy it to where you keep secrets.',
    secret: 'Secret',
    url: 'For the robot’s settings: broker, name and secret in one',
    done: 'I have it: hide it',
    columns: ['Robot', 'State', 'Made', 'Actions'],
    state: { good: 'In use', revoked: 'Revoked' },
    made_by: (when: string, by: string) => (by === '' ? when : `${when} by ${by}`),
    revokedAt: (when: string) => `Revoked ${when}`,
    revoke: 'Revoke',
    revokeOf: (robot: string) => `Revoke the key of ${robot}`,
    confirm: (robot: string) => `Revoke the key of ${robot}? The robot is cut off at once.`,
    revoked: (robot: string) => `The key of ${robot} is revoked.`,
    none: 'No robot has a key yet.',
  },

  audit: {
    who: 'Who',
    whoHint: 'A user, a robot or “server”; empty for all.',
    filter: 'Filter',
    newest: 'Newest',
    older: 'Older entries',
    end: 'These are the first entries of the log.',
    none: 'Nothing is logged yet.',
    noneOf: (who: string) => `Nothing is logged of ${who}.`,
    columns: ['Time', 'Who', 'Action', 'Outcome'],
    from: (from: string) => `from ${from}`,
    target: (target: string) => `on ${target}`,
    number: (seq: number) => `No. ${String(seq)}`,
    detail: 'Particulars',
    more: (count: number) => `${String(count)} older entries are shown now.`,
    verify: 'Verify the chain',
    verifying: 'Verifying…',
    intact: (count: number) =>
      `The log is intact: all ${count.toLocaleString('en')} entries fit together.`,
    lost: (count: number) =>
      `${count === 1 ? 'One line' : `${count.toLocaleString('en')} lines`} could not be written when there was no room. Entries “audit.gap” stand in their place.`,
    broken: (at: number | null) =>
      at === null
        ? 'The log has been changed.'
        : `The log has been changed: entry ${at.toLocaleString('en')} is not what was written.`,
  },
} as const

/** A moment, for people: the date only when it is not today. */
export function moment(time: number, now = Date.now()): string {
  const [then, today] = [new Date(time), new Date(now)]
  const clock = then.toLocaleTimeString('en-GB', { hour: '2-digit', minute: '2-digit' })
  if (then.toDateString() === today.toDateString()) return `today ${clock}`
  const day = then.toLocaleDateString('en-GB', { day: 'numeric', month: 'short', year: 'numeric' })
  return `${day}, ${clock}`
}

/** A moment to the second, as a log has it. */
export function stamp(time: number): string {
  const then = new Date(time)
  const day = then.toLocaleDateString('en-GB', { day: '2-digit', month: 'short' })
  return `${day} ${then.toLocaleTimeString('en-GB')}`
}
