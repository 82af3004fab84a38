defmodule Aerie.Access.Limiter.AttemptsTest do
  @moduledoc "Wrong passwords lock whoever tries them, and nobody else."
  use ExUnit.Case, async: true

  alias Aerie.Access.Limiter.Attempts

  @minute 60_000

  # What becomes of attempts with wrong passwords, one after another; and what is known then.
  defp wrong(attempts, places, account, now \\ 0) do
    Enum.map_reduce(places, attempts, fn place, attempts ->
      case Attempts.try(attempts, place, account, now) do
        {:ok, delay, attempts} -> {delay, Attempts.outcome(attempts, place, account, :wrong, now)}
        {:wait, seconds} -> {{:wait, seconds}, attempts}
      end
    end)
  end

  test "an address waits for the account that it tries, for a minute, and others do not" do
    one = {192, 0, 2, 1}
    {outcomes, attempts} = wrong(%Attempts{}, List.duplicate(one, 7), "admin")
    assert outcomes == [0, 0, 0, 0, 0, {:wait, 60}, {:wait, 60}]
    assert {:ok, 0, _attempts} = Attempts.try(attempts, {192, 0, 2, 2}, "admin", 0)
    assert {:ok, 0, _attempts} = Attempts.try(attempts, one, "operator", 0)
    assert {:wait, 1} = Attempts.try(attempts, one, "admin", @minute - 1)
    assert {:ok, _delay, _attempts} = Attempts.try(attempts, one, "admin", @minute)
  end

  test "an address that tries many accounts waits for all of them" do
    one = {192, 0, 2, 1}

    attempts =
      Enum.reduce(1..20, %Attempts{}, fn n, attempts ->
        {[0], attempts} = wrong(attempts, [one], "user#{n}")
        attempts
      end)

    assert {:wait, 60} = Attempts.try(attempts, one, "another", 0)
    assert {:ok, 0, _attempts} = Attempts.try(attempts, {192, 0, 2, 2}, "another", 0)
  end

  test "from many addresses a new one gets slower for that account, and is never refused; a known one does not" do
    home = {203, 0, 113, 7}
    {:ok, 0, attempts} = Attempts.try(%Attempts{}, home, "admin", 0)
    attempts = Attempts.outcome(attempts, home, "admin", :right, 0)

    many = for a <- 1..20, b <- 1..250, do: {10, 0, a, b}
    {outcomes, attempts} = wrong(attempts, many, "admin")
    assert Enum.take(outcomes, 10) == List.duplicate(0, 10)
    assert Enum.all?(outcomes, &(&1 in 0..3_000)) and List.last(outcomes) == 3_000

    assert {:ok, 0, _attempts} = Attempts.try(attempts, home, "admin", 0)
    assert {:ok, 0, _attempts} = Attempts.try(attempts, {127, 0, 0, 1}, "admin", 0)
    assert {:ok, 3_000, _attempts} = Attempts.try(attempts, {10, 9, 9, 9}, "admin", 0)
    assert {:ok, 0, _attempts} = Attempts.try(attempts, {10, 9, 9, 9}, "operator", 0)
  end

  test "what is remembered has a bound, and an attempt that was not looked at counts for nothing" do
    many = for a <- 1..40, b <- 1..250, do: {10, 1, a, b}
    {_outcomes, attempts} = wrong(%Attempts{}, many, "admin")
    assert map_size(attempts.pairs) <= 4_096 and map_size(attempts.addresses) <= 4_096

    {:ok, 0, one} = Attempts.try(%Attempts{}, {192, 0, 2, 1}, "admin", 5)
    assert Attempts.outcome(one, {192, 0, 2, 1}, "admin", :none, 5) == %Attempts{}
    assert Attempts.outcome(one, {192, 0, 2, 1}, "admin", :right, 5) == %Attempts{known: [{192, 0, 2, 1}]}
  end

  test "a host has 64 bits of IPv6 to itself; this machine is one, by all its addresses" do
    assert Attempts.place({0x2001, 0xDB8, 1, 2, 3, 4, 5, 6}) ==
             Attempts.place({0x2001, 0xDB8, 1, 2, 9, 9, 9, 9})

    assert Attempts.place({0x2001, 0xDB8, 1, 3, 3, 4, 5, 6}) !=
             Attempts.place({0x2001, 0xDB8, 1, 2, 3, 4, 5, 6})

    assert Attempts.place({0, 0, 0, 0, 0, 0xFFFF, 0xC000, 0x0201}) == {192, 0, 2, 1}

    for local <- [{127, 0, 0, 1}, {127, 9, 8, 7}, {0, 0, 0, 0, 0, 0, 0, 1}],
        do: assert(Attempts.known?(%Attempts{}, Attempts.place(local)))
  end
end
