/** Who may do what. The server decides; the page only does not offer what it would refuse. */

export const ROLES = ['viewer', 'operator', 'admin'] as const
export type Role = (typeof ROLES)[number]

export function parseRole(value: unknown): Role | null {
  return ROLES.find((role) => role === value) ?? null
}

/** Whether a role may do what another one may. */
export function includes(role: Role, needed: Role): boolean {
  return ROLES.indexOf(role) >= ROLES.indexOf(needed)
}
