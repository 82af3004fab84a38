defmodule MavRouter.Link.Transport.Net.SendersTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Transport.Net.Senders

  test "a sender is known since its first datagram, and forgotten after a minute of silence" do
    senders = Senders.note(Senders.new(), [{:a, ""}], 1_000)
    assert Senders.since(senders, {:a, nil}) == 1_000
    senders = Enum.reduce(1..10, senders, &Senders.note(&2, [{:a, "x"}], &1 * 20_000))
    assert Senders.since(senders, {:a, nil}) == 1_000
    senders = Enum.reduce([231_000, 262_000], senders, &Senders.note(&2, [{:b, ""}], &1))
    assert Senders.since(senders, {:a, nil}) == nil
    assert Senders.since(senders, {:b, nil}) == 231_000
  end

  test "made-up addresses are bounded, and make nobody forgotten" do
    flood = fn from -> for n <- 1..10_000, do: {{from, n}, ""} end

    senders =
      Enum.reduce(0..20, Senders.note(Senders.new(), [{:known, ""}], 0), fn n, senders ->
        Senders.note(senders, flood.(n) ++ [{:known, ""}], n * 15_000)
      end)

    assert Senders.since(senders, {:known, nil}) == 0
    assert map_size(senders.recent) <= 4_096 and map_size(senders.former) <= 4_096
  end
end
