defmodule Aerie.Access.TicketsTest do
  use ExUnit.Case, async: true

  alias Aerie.Access.{Principals, Tickets}

  @alice Principals.of(%{name: "alice", digest: "", role: :operator, permissions: [:terminate], until: nil})

  defp start_tickets do
    gateway = make_ref()
    clock = :atomics.new(1, [])
    start_supervised!({Tickets, gateway: gateway, now: fn -> :atomics.get(clock, 1) end})
    {gateway, clock}
  end

  test "a ticket is valid once, and stands for whom it was issued to" do
    {gateway, _clock} = start_tickets()
    {:ok, ticket, 30} = Tickets.issue(gateway, @alice)
    assert Tickets.redeem(gateway, ticket) == {:ok, @alice}
    assert Tickets.redeem(gateway, ticket) == :error
    assert Tickets.redeem(gateway, "x") == :error
    assert Tickets.redeem(gateway, String.duplicate("x", 5000)) == :error
    assert Tickets.redeem(make_ref(), ticket) == :error
  end

  test "a ticket expires, and the number of unused ones is limited" do
    {gateway, clock} = start_tickets()
    {:ok, ticket, _seconds} = Tickets.issue(gateway, @alice)
    :atomics.put(clock, 1, 30_000)
    assert Tickets.redeem(gateway, ticket) == :error

    for _ <- 1..1000, do: assert({:ok, _ticket, _seconds} = Tickets.issue(gateway, @alice))
    assert Tickets.issue(gateway, @alice) == {:error, :too_many}
    :atomics.put(clock, 1, 60_000)
    assert {:ok, _ticket, _seconds} = Tickets.issue(gateway, @alice)
  end
end
