/** Words about fences; loaded with their list. */

import type { FenceBody } from './api-types'
import type { Flaw } from './fences/shape'

export const kinds: Record<FenceBody['kind'], string> = {
  keep_in: 'Keep in',
  keep_out: 'Keep out',
}

export const actions: Record<FenceBody['action'], string> = {
  warn: 'Warn',
  stop: 'Stop the robot',
}

/** What stands at a fence in the picture. */
export function labelOf({ name, kind, action }: FenceBody): string {
  return `${name} · ${kinds[kind].toLowerCase()}${action === 'stop' ? ' · stop' : ''}`
}

export const words = {
  title: 'Fences',
  close: 'Close the list of fences',
  empty: 'No fences yet. Every fence holds for every robot.',
  list: 'Fences',
  count: (count: number) => `${String(count)} corners`,
  by: (name: string) => `by ${name}`,
  beyond: (names: readonly string[]) =>
    names.length <= 3
      ? `Beyond it: ${names.join(', ')}`
      : `Beyond it: ${names.slice(0, 3).join(', ')} and ${String(names.length - 3)} more`,
  failed: (why: string) => `The fences could not be read: ${why}.`,
  notDone: (why: string) => `Not done: ${why}.`,

  need: 'You may look. Changing fences needs the role operator.',

  draw: 'Draw a fence',
  enter: 'Enter coordinates',
  edit: 'Edit',
  editOf: (name: string) => `Edit fence ${name}`,
  remove: 'Delete',
  removeOf: (name: string) => `Delete fence ${name}`,
  sure: (name: string) => `Delete fence ${name}? Robots may cross it then.`,

  drawing: 'Drawing a fence',
  hint: (corners: number) =>
    corners === 0
      ? 'Click the corners of the fence.'
      : corners < 3
        ? `${String(corners)} of at least 3 corners. Backspace takes the last back.`
        : `${String(corners)} corners. Enter, a double click or the first corner closes.`,
  finish: 'Finish',
  takeBack: 'Take back',
  cancel: 'Cancel',
  drawn: (corners: number) => `A fence with ${String(corners)} corners is drawn. Give it a name.`,
  cancelled: 'Drawing was cancelled.',
  tangled: 'The line runs into itself: take the last corner back.',
  full: 'A fence has at most 32 corners: finish it.',

  newTitle: 'New fence',
  editTitle: (name: string) => `Fence ${name}`,
  name: 'Name',
  noName: 'Give it a name of 1 to 32 characters.',
  kind: 'Robots are to be',
  kindWords: { keep_in: 'inside (keep in)', keep_out: 'outside (keep out)' },
  action: 'Whoever crosses it',
  actionWords: { warn: 'is told of (warn)', stop: 'is told of and stopped (stop)' },
  corners: 'Corners',
  cornersHint: 'One to a line: x, y in metres. The last is joined to the first.',
  badLine: (line: number) => `Line ${String(line)} is not x, y.`,
  flaw(flaw: Flaw): string {
    switch (flaw.flaw) {
      case 'few':
        return 'A fence has at least 3 corners.'
      case 'many':
        return 'A fence has at most 32 corners.'
      case 'far':
        return `Corner ${String(flaw.corner)} is too far away.`
      case 'twice':
        return `Corner ${String(flaw.corner)} is where the one before it is.`
      case 'crossing':
        return `The edges from corner ${String(flaw.one)} and corner ${String(flaw.other)} cross or touch.`
      case 'small':
        return 'It encloses next to nothing: less than 0.01 m².'
    }
  },
  redraw: 'Draw the corners anew',
  save: 'Save',
  saving: 'Saving…',
  added: (name: string) => `Fence ${name} is up.`,
  changed: (name: string) => `Fence ${name} is changed.`,
  removed: (name: string) => `Fence ${name} is gone.`,
} as const
