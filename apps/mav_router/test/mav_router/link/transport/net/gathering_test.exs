defmodule MavRouter.Link.Transport.Net.GatheringTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Transport.Net.Gathering

  # So many reads a second for `ms`, each of one datagram of the next of so many senders.
  defp reads(gathering, from, ms, per_ms, senders) do
    for at <- from..(from + ms - 1), n <- 1..per_ms, reduce: gathering do
      gathering -> Gathering.read(gathering, [{{:sender, rem(at * per_ms + n, senders)}, "x"}], at)
    end
  end

  test "gathers while many senders are read often" do
    busy = reads(Gathering.new(), 0, 101, 5, 200)
    assert Gathering.wait_ms(busy) == 1

    # It then reads less often, and as many datagrams.
    gathered =
      for at <- 101..400, reduce: busy do
        gathering -> Gathering.read(gathering, for(n <- 1..5, do: {{:sender, n}, "x"}), at)
      end

    assert Gathering.wait_ms(gathered) == 1
    quiet = reads(gathered, 500, 210, 1, 1)
    assert Gathering.wait_ms(quiet) == 0
  end

  test "does not delay a single sender, however fast, nor a few slow ones" do
    assert 0 == Gathering.new() |> reads(0, 500, 20, 1) |> Gathering.wait_ms()
    assert 0 == Gathering.new() |> reads(0, 500, 1, 50) |> Gathering.wait_ms()
  end

  test "a window that ended long ago does not count" do
    busy = reads(Gathering.new(), 0, 100, 5, 200)
    assert 0 == busy |> Gathering.read([{:late, "x"}], 5_000) |> Gathering.wait_ms()
  end
end
