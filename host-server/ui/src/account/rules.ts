/** What names and passwords must be like, as the server checks it too. */

const SHORTEST_PASSWORD = 10
const LONGEST_PASSWORD = 256

export type PasswordRule = 'length' | 'name'

/** Every rule, and whether a password keeps it. An empty one keeps none. */
export function passwordRules(
  name: string,
  password: string,
): readonly { rule: PasswordRule; met: boolean }[] {
  const length = [...password].length
  return [
    { rule: 'length', met: length >= SHORTEST_PASSWORD && length <= LONGEST_PASSWORD },
    { rule: 'name', met: password !== '' && password.toLowerCase() !== name.toLowerCase() },
  ]
}

export function passwordIsGood(name: string, password: string): boolean {
  return passwordRules(name, password).every(({ met }) => met)
}

/** A user's name: a small letter, then small letters, digits, dots, dashes, underscores. */
export function isUserName(name: string): boolean {
  return /^[a-z][a-z0-9._-]{0,31}$/.test(name)
}

/** Whose key it may be: a robot, a simulator with many robots, or a learner. */
export function isRobotId(id: string): boolean {
  return /^[a-z0-9-]{1,32}$/.test(id)
}

/** What a link to accept an invitation carries behind its `#`. */
export function invitationOf(hash: string): { code: string; name: string } | null {
  if (!hash.startsWith('#invite=')) return null
  const parts = new URLSearchParams(hash.slice(1))
  const code = parts.get('invite') ?? ''
  if (!/^[A-Za-z0-9_-]{1,128}$/.test(code)) return null
  const name = parts.get('name') ?? ''
  return { code, name: isUserName(name) ? name : '' }
}

/**
 * The link to hand on: at the address this page was reached by, which behind a
 * proxy the server need not know, and with the name that it is for.
 */
export function invitationLink(given: string, origin: string, name: string): string {
  const at = given.indexOf('#')
  const code = at < 0 ? undefined : invitationOf(given.slice(at))?.code
  return code === undefined ? given : `${origin}/#invite=${code}&name=${name}`
}
