defmodule Aerie.Control.Commands.Gateways.SendingTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Commands.Gateways.Sending

  test "the holder claims, and sends while its lease lasts" do
    state = Sending.new(1_000, false)
    assert {state, :go_on} = Sending.handle(state, {:holder, {:mine, 500}, 0})
    assert {state, :claim} = Sending.handle(state, {:holder, {:mine, 500}, 499})
    assert {state, :go_on} = Sending.handle(state, {:claimed, :ok})
    assert {_over, {:send, :fleet}} = Sending.handle(state, {:holder, {:mine, 900}, 501})
    assert {_over, {:refuse, {:deny, :holder, _}}} = Sending.handle(state, {:holder, {:mine, 500}, 500})
    assert {_over, {:refuse, {:deny, :holder, _}}} = Sending.handle(state, {:holder, {:other, "b"}, 1})
  end

  test "a claim of another gateway or one that failed ends it; a gateway that is alone needs no claim" do
    held = fn holder ->
      {state, :go_on} = Sending.handle(Sending.new(1_000, false), {:holder, holder, 0})
      {state, :claim} = Sending.handle(state, {:holder, holder, 0})
      state
    end

    assert {_over, {:known, :them}} = Sending.handle(held.({:mine, 500}), {:claimed, {:taken, :them}})

    assert {_over, {:refuse, {:deny, :claim, _}}} =
             Sending.handle(held.({:mine, 500}), {:claimed, {:error, "no"}})

    assert {_over, {:known, :them}} = Sending.handle(held.(:alone), {:claimed, {:taken, :them}})
    assert {state, :go_on} = Sending.handle(held.(:alone), {:claimed, {:error, "no"}})
    assert {_over, {:send, :gateway}} = Sending.handle(state, {:holder, :alone, 0})
  end

  test "what brings a vehicle down waits for no lease: unknown, not renewed, not claimed, or relayed" do
    for {relayed?, holder} <- [
          {false, {:unknown, "NATS is away"}},
          {false, {:mine, 10}},
          {true, {:other, "b"}}
        ] do
      state = Sending.new(1_000, relayed?, true)
      assert {state, :go_on} = Sending.handle(state, {:holder, holder, 1_000})
      assert {state, :claim} = Sending.handle(state, {:holder, holder, 1_000})
      assert {state, :go_on} = Sending.handle(state, {:claimed, {:error, "NATS is away"}})
      assert {_over, {:send, :urgent}} = Sending.handle(state, {:holder, holder, 1_001})
    end

    # With a lease nothing changes, but for a claim that somebody else made: it may be forged.
    state = Sending.new(1_000, false, true)
    assert {_over, {:pass_on, "b"}} = Sending.handle(state, {:holder, {:other, "b"}, 0})
    assert {_state, {:again, _ms}} = Sending.handle(state, {:holder, {:unknown, "why"}, 999})
    assert {state, :go_on} = Sending.handle(state, {:holder, {:mine, 500}, 0})
    assert {state, :claim} = Sending.handle(state, {:holder, {:mine, 500}, 0})
    assert {_state, :go_on} = Sending.handle(state, {:claimed, {:taken, :them}})
    assert {state, :go_on} = Sending.handle(state, {:claimed, :ok})
    assert {_over, {:send, :fleet}} = Sending.handle(state, {:holder, {:mine, 500}, 1})
  end

  test "another one's command is passed on, but not twice; without knowing who holds it nothing is sent" do
    assert {_over, {:pass_on, "b"}} =
             Sending.handle(Sending.new(1_000, false), {:holder, {:other, "b"}, 0})

    assert {_over, {:refuse, {:deny, :holder, _}}} =
             Sending.handle(Sending.new(1_000, true), {:holder, {:other, "b"}, 0})

    state = Sending.new(1_000, false)
    assert {^state, {:again, _ms}} = Sending.handle(state, {:holder, {:unknown, "why"}, 999})
    assert {^state, {:again, _ms}} = Sending.handle(state, {:holder, {:mine, 10}, 999})

    assert {_over, {:refuse, {:deny, :holder, "why; nothing was sent"}}} =
             Sending.handle(state, {:holder, {:unknown, "why"}, 1_000})
  end
end
