/** Words of the login, of accounts and of what a role may do; part of the first view. */

import type { PasswordRule } from './account/rules'
import type { Role } from './account/roles'

export const roles: Record<Role, string> = {
  viewer: 'Viewer',
  operator: 'Operator',
  admin: 'Admin',
}

export const words = {
  /** Reasons why a control is off. */
  need: {
    operator: 'Commands need the role operator.',
    stop: 'You may watch. Stopping robots needs the role operator.',
    drive: 'You may watch. Driving needs the role operator.',
    stopRefused: 'The server does not let you stop robots: your role is viewer.',
  },

  bar: {
    account: 'Your account:',
    open: 'open',
    toRoom: 'Control room',
    logOut: 'Log out',
    notLoggedOut: (why: string) => `Not logged out: ${why}. Try again.`,
    openHint: 'This server has no accounts: whoever reaches it may do everything.',
  },

  entrance: {
    starting: 'Connecting to the server…',
    unreachable: 'The server cannot be reached',
    unreachableMore: (why: string) => `${capital(why)}. The page tries again by itself.`,
    retry: 'Retry now',
    noAnswer: 'the server did not answer',
    oddAnswer: 'the server answered in a way this page does not understand',
    loggedOut: 'You are not logged in',
    stopNote: 'Until you log in, this page cannot stop robots. Use the switch on the robot.',
    broken: 'A part of the page could not be loaded',
    brokenMore: 'The server may have been updated. Reload the page.',
    reload: 'Reload',
  },

  login: {
    title: 'Log in',
    why: {
      ended: 'Your session has ended. Log in to go on: your view is kept.',
      'logged-out': 'You are logged out.',
      elsewhere: 'You logged out in another tab.',
    },
    user: 'Name',
    password: 'Password',
    submit: 'Log in',
    busy: 'Logging in…',
    welcome: (name: string) => `Logged in as ${name}.`,
    noAccount: 'No account? An admin can send you an invitation.',
    missingUser: 'Enter your name.',
    missingPassword: 'Enter your password.',
    failed: (why: string) => `Not logged in: ${why}.`,
  },

  invite: {
    title: 'Welcome',
    lead: 'You were invited to this control room. Choose a password to make your account.',
    leadUnnamed: 'You were invited to this control room. Choose a name and a password.',
    name: 'Name',
    nameHint:
      'Starts with a small letter; then small letters, digits, dots, dashes or underscores; 32 at most.',
    submit: 'Make the account',
    busy: 'Making the account…',
    badName: 'This cannot be a name: see the rule above.',
    failed: (why: string) => `The account was not made: ${why}.`,
    toLogin: 'I have an account: log in',
    open: 'This server has no accounts, so there is nothing to accept.',
    already: (name: string) =>
      `You are logged in as ${name}. Log out first to accept this invitation.`,
    dismiss: 'Dismiss',
  },

  field: {
    show: 'Show',
    hide: 'Hide',
    showPassword: 'Show the password',
    hidePassword: 'Hide the password',
  },

  password: {
    next: 'New password',
    again: 'The same again',
    rules: 'A good password',
    rule: {
      length: 'has 10 to 256 characters',
      name: 'is not your name',
    } satisfies Record<PasswordRule, string>,
    met: 'kept',
    notMet: 'not kept yet',
    weak: 'The password does not keep the rules below.',
    differ: 'The two passwords differ.',
  },

  failure: {
    bad_credentials: 'name or password is wrong',
    too_many_attempts: (seconds: number | null) =>
      seconds === null
        ? 'too many attempts; wait a while'
        : `too many attempts; try again in ${wait(seconds)}`,
    invitation: 'the invitation is not valid: it was used, has run out or was mistyped',
  },
} as const

export function wait(seconds: number): string {
  if (seconds <= 90) return `${String(seconds)} s`
  return `${String(Math.ceil(seconds / 60))} min`
}

function capital(sentence: string): string {
  return sentence.slice(0, 1).toUpperCase() + sentence.slice(1)
}
