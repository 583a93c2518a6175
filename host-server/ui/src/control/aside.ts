/** What a page puts beside itself, in the place of the live log of events. */

import type { Component, InjectionKey, ShallowRef } from 'vue'

export const ASIDE: InjectionKey<ShallowRef<Component | null>> = Symbol('aside')
