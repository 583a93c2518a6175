/** Two pictures of one place, side by side: what moves the view of one moves that of the other. */

import { watch } from 'vue'
import type { Stage } from './stage'

export function mirror(one: Stage, other: Stage): void {
  follow(one, other)
  follow(other, one)
}

function follow(from: Stage, to: Stage): void {
  watch([from.camera, from.fitted], ([camera, fitted]) => {
    // Each fits itself into the room that it has.
    if (fitted) {
      if (!to.fitted.value) to.showEverything()
    } else if (to.camera.value !== camera) {
      to.setCamera(camera)
    }
  })
}
