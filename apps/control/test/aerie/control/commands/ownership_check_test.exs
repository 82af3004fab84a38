defmodule Aerie.Control.Commands.OwnershipCheckTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Commands.OwnershipCheck

  test "the holder claims, and sends while its lease lasts" do
    state = OwnershipCheck.new(1_000, false)
    assert {state, :go_on} = OwnershipCheck.handle(state, {:holder, {:mine, 500}, 0})
    assert {state, :claim} = OwnershipCheck.handle(state, {:holder, {:mine, 500}, 499})
    assert {state, :go_on} = OwnershipCheck.handle(state, {:claimed, :ok})
    assert {_over, {:send, :fleet}} = OwnershipCheck.handle(state, {:send?, {:mine, 900}, 501})
    assert {_over, {:refuse, :holder, _}} = OwnershipCheck.handle(state, {:send?, {:mine, 500}, 500})
    assert {_over, {:refuse, :holder, _}} = OwnershipCheck.handle(state, {:send?, {:other, "b"}, 1})
  end

  test "a claim of another gateway or one that failed ends it; a gateway that is alone needs no claim" do
    held = fn holder ->
      {state, :go_on} = OwnershipCheck.handle(OwnershipCheck.new(1_000, false), {:holder, holder, 0})
      {state, :claim} = OwnershipCheck.handle(state, {:holder, holder, 0})
      state
    end

    assert {_over, {:known, :them}} = OwnershipCheck.handle(held.({:mine, 500}), {:claimed, {:taken, :them}})

    assert {_over, {:refuse, :claim, _}} =
             OwnershipCheck.handle(held.({:mine, 500}), {:claimed, {:error, "no"}})

    assert {_over, {:known, :them}} = OwnershipCheck.handle(held.(:alone), {:claimed, {:taken, :them}})
    assert {state, :go_on} = OwnershipCheck.handle(held.(:alone), {:claimed, {:error, "no"}})
    assert {_over, {:send, :gateway}} = OwnershipCheck.handle(state, {:send?, :alone, 0})
  end

  test "another one's command is passed on, but not twice; without knowing who holds it nothing is sent" do
    assert {_over, {:pass_on, "b"}} =
             OwnershipCheck.handle(OwnershipCheck.new(1_000, false), {:holder, {:other, "b"}, 0})

    assert {_over, {:refuse, :holder, _}} =
             OwnershipCheck.handle(OwnershipCheck.new(1_000, true), {:holder, {:other, "b"}, 0})

    state = OwnershipCheck.new(1_000, false)
    assert {^state, {:again, _ms}} = OwnershipCheck.handle(state, {:holder, {:unknown, "why"}, 999})
    assert {^state, {:again, _ms}} = OwnershipCheck.handle(state, {:holder, {:mine, 10}, 999})

    assert {_over, {:refuse, :holder, "why"}} =
             OwnershipCheck.handle(state, {:holder, {:unknown, "why"}, 1_000})
  end
end
