// @vitest-environment happy-dom

import { mount } from '@vue/test-utils'
import { describe, expect, it, vi } from 'vitest'
import { nextTick, ref } from 'vue'
import { accountApi } from '../../src/account/api'
import type { Role } from '../../src/account/roles'
import { ROLES, includes, parseRole } from '../../src/account/roles'
import {
  invitationLink,
  invitationOf,
  isRobotId,
  isUserName,
  passwordIsGood,
  passwordRules,
} from '../../src/account/rules'
import { trouble } from '../../src/account/trouble'
import { createApi } from '../../src/api'
import DrivePad from '../../src/components/DrivePad.vue'
import NewPassword from '../../src/components/NewPassword.vue'
import StopPanel from '../../src/components/StopPanel.vue'
import { ROOM, Room } from '../../src/control/room'
import { ApiError } from '../../src/http'
import { pagesFor, viewOf } from '../../src/view'

describe('roles', () => {
  it('include those below them', () => {
    const may = (role: Role) => ROLES.filter((needed) => includes(role, needed))
    expect(may('viewer')).toEqual(['viewer'])
    expect(may('operator')).toEqual(['viewer', 'operator'])
    expect(may('admin')).toEqual(['viewer', 'operator', 'admin'])
  })

  it('unknown ones are none', () => {
    for (const odd of ['Admin', 'root', '', null, 3]) expect(parseRole(odd)).toBeNull()
  })

  it('have their pages', () => {
    expect(pagesFor('viewer')).toEqual(['account'])
    expect(pagesFor('operator')).toEqual(['account'])
    expect(pagesFor('admin')).toEqual(['account', 'people', 'keys', 'audit'])
    expect([viewOf(''), viewOf('#/'), viewOf('#/people'), viewOf('#/nonsense')]).toEqual([
      'room',
      'room',
      'people',
      'room',
    ])
  })
})

describe('passwords', () => {
  it.each([
    ['ada', '', false],
    ['ada', 'ninechars', false],
    ['ada', 'ten charac', true],
    ['ada', '🦀'.repeat(9), false],
    ['ada', '🦀'.repeat(10), true],
    ['ada', 'x'.repeat(256), true],
    ['ada', 'x'.repeat(257), false],
    ['ada.lovelace', 'Ada.Lovelace', false],
  ])('of %s: %j → %s', (name, password, good) => {
    expect(passwordIsGood(name, password)).toBe(good)
  })

  it('say which rule is not kept', () => {
    expect(passwordRules('long.user.name', 'long.user.name')).toEqual([
      { rule: 'length', met: true },
      { rule: 'name', met: false },
    ])
  })
})

describe('names', () => {
  it('are as the server takes them', () => {
    for (const good of ['a', 'ada', 'a.b-c_9', `a${'b'.repeat(31)}`]) {
      expect(isUserName(good)).toBe(true)
    }
    for (const bad of ['', 'Ada', '9a', '.a', 'a b', 'ä', `a${'b'.repeat(32)}`, 'ada\n']) {
      expect(isUserName(bad)).toBe(false)
    }
    expect([isRobotId('rover-1'), isRobotId('9'), isRobotId('Rover'), isRobotId('')]).toEqual([
      true,
      true,
      false,
      false,
    ])
  })
})

describe('invitations', () => {
  it('are read from the address', () => {
    expect(invitationOf('#invite=Ab_-9')).toEqual({ code: 'Ab_-9', name: '' })
    expect(invitationOf('#invite=x&name=bob')).toEqual({ code: 'x', name: 'bob' })
    expect(invitationOf('#invite=x&name=<b>')).toEqual({ code: 'x', name: '' })
    for (const none of ['', '#', '#invite=', '#invite=a/b', '#/people', '#x&invite=a']) {
      expect(invitationOf(none)).toBeNull()
    }
  })

  it('are handed on at the address of the page', () => {
    expect(invitationLink('http://0.0.0.0:8080/#invite=abc', 'https://fleet.example', 'bob')).toBe(
      'https://fleet.example/#invite=abc&name=bob',
    )
    expect(invitationLink('odd', 'https://fleet.example', 'bob')).toBe('odd')
  })
})

describe('what went wrong', () => {
  it('is said in words', () => {
    expect(trouble(new ApiError('x', 401, 'bad_credentials'))).toContain('wrong')
    expect(trouble(new ApiError('x', 429, 'too_many_attempts', 30))).toContain('30 s')
    expect(trouble(new ApiError('x', 429, 'rate_limited', 600))).toContain('10 min')
    expect(trouble(new ApiError('Title: detail', 422, 'odd', null, 'detail'))).toBe('detail')
    expect(trouble(new ApiError('x', 401, 'bad_invitation'))).toContain('invitation')
    expect(trouble(new ApiError('words of the server', 500))).toBe('words of the server')
  })

  it('takes the time to wait from the answer', async () => {
    const api = createApi(() =>
      Promise.resolve(
        new Response('{"title":"Too many","code":"rate_limited"}', {
          status: 429,
          headers: { 'retry-after': '7' },
        }),
      ),
    )
    await expect(api.summaries()).rejects.toMatchObject({ code: 'rate_limited', retryAfter: 7 })
  })
})

describe('what the server lists', () => {
  const answering = (body: unknown) =>
    accountApi(() => Promise.resolve(new Response(JSON.stringify(body))))

  it('is read, and what makes no sense is left out', async () => {
    const users = await answering({
      users: [{ name: 'ada', role: 'admin', created: 5 }, { name: 'x', role: 'king' }, null],
    }).users()
    expect(users).toEqual([
      { name: 'ada', role: 'admin', invited: false, disabled: false, created: 5 },
    ])
    expect(await answering({ sessions: [{ id: 7, current: true }, {}] }).sessions()).toMatchObject([
      { id: '7', current: true },
    ])
    expect(await answering([{ name: 'rover-1', revoked: null }]).credentials()).toMatchObject([
      { robot: 'rover-1', revoked: null },
    ])
    expect(await answering('nonsense').audit('', null, 5)).toEqual({ entries: [], next: null })
    expect(await answering({ entries: 3 }).verifyAudit()).toEqual({
      entries: 3,
      intact: false,
      brokenAt: null,
      lost: 0,
    })
    const gap = { entries: 3, intact: true, lost: 2 }
    expect(await answering(gap).verifyAudit()).toMatchObject({ intact: true, lost: 2 })
  })
})

describe('the controls of a viewer', () => {
  const setUp = (start: Role) => {
    const sent: string[] = []
    const api = createApi((url) => {
      sent.push(url as string)
      return Promise.resolve(new Response('{"id":"1"}', { status: 202 }))
    })
    const role = ref<Role>(start)
    const room = new Room({ url: 'ws://test', api, role })
    room.status.value = { state: 'live', attempt: 0, retryAt: null }
    const global = { provide: { [ROOM as symbol]: room } }
    return { sent, role, room, global }
  }

  it('are off, with the reason, and on as soon as the role allows', async () => {
    const { sent, role, room, global } = setUp('viewer')
    const panel = mount(StopPanel, { global })
    const stop = panel.find('[data-testid=stop-all]')
    expect(stop.attributes('disabled')).toBeDefined()
    expect(panel.find(`#${stop.attributes('aria-describedby') ?? ''}`).text()).toContain('operator')
    expect(panel.find('[data-testid=wander-all]').exists()).toBe(false)
    room.stopAll()
    expect(room.announcement.value).toContain('operator')
    expect([sent.length, room.stopState.value]).toEqual([0, 'armed'])
    role.value = 'operator'
    await nextTick()
    await panel.find('[data-testid=stop-all]').trigger('click')
    expect(sent).toHaveLength(1)
  })

  it('do not drive', () => {
    const { sent, room, global } = setUp('viewer')
    room.select('sim-0001')
    sent.length = 0
    const pad = mount(DrivePad, { global })
    expect(pad.attributes('data-blocked')).toBe('role')
    expect(pad.find('[data-testid=drive-words]').text()).toContain('operator')
    expect(room.hold('key:x', 'forward')).toBe(false)
    expect(sent).toEqual([])
  })

  it('a stop that the server forbids is not shown as one', async () => {
    const api = createApi(() => Promise.resolve(new Response('{}', { status: 403 })))
    const room = new Room({ url: 'ws://test', api })
    room.stopAll()
    await vi.waitFor(() => expect(room.stopError.value).toContain('viewer'), 60_000)
    expect(room.stopState.value).toBe('armed')
  })
})

describe('choosing a password', () => {
  it('shows the rules, and what is wrong once asked', async () => {
    const form = mount(NewPassword, { props: { name: 'ada', modelValue: 'short' } })
    expect(form.findAll('[data-met=true]')).toHaveLength(1)
    expect(form.find('[data-testid=new-password]').attributes('aria-invalid')).toBe('false')
    expect(form.vm.check()).toBe(false)
    await nextTick()
    const field = form.find('[data-testid=new-password]')
    expect(field.attributes('aria-invalid')).toBe('true')
    expect(form.find(`#${field.attributes('aria-describedby') ?? ''}`).exists()).toBe(true)
    await form.setProps({ modelValue: 'long enough now' })
    expect(form.vm.check()).toBe(false)
    await form.find('[data-testid=again]').setValue('long enough now')
    expect(form.vm.check()).toBe(true)
  })
})
