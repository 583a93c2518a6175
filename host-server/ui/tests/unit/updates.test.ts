// @vitest-environment happy-dom

import { flushPromises, mount } from '@vue/test-utils'
import { describe, expect, it, vi } from 'vitest'
import { ApiError, request } from '../../src/http'
import AddRelease from '../../src/pages/updates/AddRelease.vue'
import { updatesApi } from '../../src/pages/updates/api'
import { kindOf, one } from '../../src/strings-updates'
import { LARGEST_FILE, faultsOf, gateOf, isReason, standing } from '../../src/updates/releases'

const answer = (body: unknown): Promise<Response> => Promise.resolve(Response.json(body))

describe('a release', () => {
  it('can be given to robots until it expires or is withdrawn', () => {
    const withdrawn = { by: 'ada', at: 1, reason: 'x' }
    expect(standing({ withdrawn: null, expires_at: null }, 5)).toBe('good')
    expect(standing({ expires_at: 6 }, 5)).toBe('good')
    expect(standing({ expires_at: 5 }, 5)).toBe('expired')
    expect(standing({ withdrawn, expires_at: 5 }, 5)).toBe('withdrawn')
  })

  it('has passed its gate only where the server says so', () => {
    const told = [null, 'passed', 'failed', 'skipped']
    const gates = [gateOf({}), ...told.map((gate) => gateOf({ gate }))]
    expect(gates).toEqual(['none', 'none', 'passed', 'failed', 'failed'])
    expect(gates.every((gate) => one.gates[gate] !== '')).toBe(true)
  })

  it('is called by what it is', () => {
    expect(kindOf({ kind: 'program', name: null })).toBe('Program')
    expect(kindOf({ kind: 'model', name: 'eyes' })).toBe('Model eyes')
    expect(one.requires(0, 0)).toBe('')
    expect(one.requires(9, 1)).toBe('sequence 9 or later, protocol 1 or later')
    expect(one.bytes(608_100, 10, 65_536)).toBe('608,100 bytes in 10 blocks of 64 KiB')
  })

  it('is withdrawn for a reason that fits', () => {
    expect(['', '  ', 'x'.repeat(513), 'ü'.repeat(257)].some(isReason)).toBe(false)
    expect([' x ', 'x'.repeat(512), 'ü'.repeat(256)].every(isReason)).toBe(true)
  })
})

describe('what the server has against a file', () => {
  it('is every reason that it names, and nothing else', () => {
    const of = (problem: unknown) =>
      faultsOf(new ApiError('x', 422, 'invalid_release', null, null, problem))
    const bad = { code: 'bad_block', text: 'block 3 is wrong' }
    expect(of({ faults: [bad, { code: 'expired', text: 'expired' }] })).toHaveLength(2)
    expect(of({ faults: [bad, null, 3, { code: 'x' }, {}] })).toEqual([bad])
    expect(of({ faults: 'all' })).toEqual([])
    expect(of(null)).toEqual([])
    expect(faultsOf(new Error('x'))).toEqual([])
  })
})

describe('calls', () => {
  it('send a file as it is', async () => {
    const send = vi.fn(() => answer({ id: 'a' }))
    const file = new Blob(['bytes'])
    await updatesApi(send as unknown as typeof fetch).add(file)
    const [address, init] = send.mock.calls[0] as unknown as [string, RequestInit]
    expect(address).toBe('/api/v1/releases')
    expect(init.headers).toEqual({ 'content-type': 'application/octet-stream' })
    expect(init.body).toBe(file)
    // A browser lets no more than 64 KiB outlive its page.
    expect(init.keepalive).toBe(false)
    await request(send as unknown as typeof fetch, 'POST', '/stop', { a: 1 })
    const [, other] = send.mock.calls[1] as unknown as [string, RequestInit]
    expect([other.body, other.keepalive]).toEqual(['{"a":1}', true])
  })

  it('ask page by page', async () => {
    const pages = [
      { releases: [{ id: 'b' }], next: 'b', can_add: true },
      { releases: [{ id: 'a' }], next: null, can_add: true },
    ]
    const asked: string[] = []
    const send = ((address: string) => {
      asked.push(address)
      return answer(pages[asked.length - 1])
    }) as unknown as typeof fetch
    const found = await updatesApi(send).releases(5)
    expect(found.releases.map(({ id }) => id)).toEqual(['b', 'a'])
    expect([found.more, found.canAdd]).toEqual([false, true])
    expect(asked).toEqual(['/api/v1/releases?limit=50', '/api/v1/releases?limit=50&before=b'])
    asked.length = 0
    expect((await updatesApi(send).releases(1)).more).toBe(true)
  })
})

describe('the form', () => {
  const choose = (wrapper: ReturnType<typeof mount>, file: File | null) => {
    const input = wrapper.get<HTMLInputElement>('[data-testid=release-file]').element
    const files = file === null ? [] : [file]
    Object.defineProperty(input, 'files', { value: files, configurable: true })
    return wrapper.get('form').trigger('submit')
  }

  it('sends nothing that can be none', async () => {
    const add = vi.fn()
    const wrapper = mount(AddRelease, { props: { api: { add } } })
    await choose(wrapper, null)
    expect(wrapper.get('.trouble').text()).toBe('Choose a file.')
    const large = new File(['x'], 'large')
    Object.defineProperty(large, 'size', { value: LARGEST_FILE + 1 })
    await choose(wrapper, large)
    expect(wrapper.get('.trouble').text()).toContain('larger')
    expect(add).not.toHaveBeenCalled()
  })

  it('says what became of it', async () => {
    const faults = [{ code: 'expired', text: 'expired' }]
    const refused = new ApiError('x', 422, 'invalid_release', null, 'x', { faults })
    const add = vi
      .fn()
      .mockRejectedValueOnce(refused)
      .mockRejectedValueOnce(new ApiError('the server cannot be reached', 0))
      .mockResolvedValue({ id: '9f2c1ab034d5e6f7' })
    const wrapper = mount(AddRelease, { props: { api: { add } } })
    const file = new File(['x'], 'x.release')
    await choose(wrapper, file)
    await flushPromises()
    expect(wrapper.findAll('[data-fault]').map((line) => line.text())).toEqual(['expired expired'])
    await choose(wrapper, file)
    await flushPromises()
    expect(wrapper.get('[role=alert]').text()).toContain('cannot be reached')
    expect(wrapper.emitted('added')).toBeUndefined()
    await choose(wrapper, file)
    await flushPromises()
    expect(wrapper.get('[data-testid=release-added]').text()).toContain('9f2c1ab034d5e6f7')
    expect(wrapper.emitted('added')).toHaveLength(1)
    expect(wrapper.find('[role=alert]').exists()).toBe(false)
  })
})
