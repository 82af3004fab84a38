defmodule MavCodec.TlogStampTest do
  @moduledoc "G1: what stands before a frame is not always its time."
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire

  alias MavCodec.{Frame, Tlog}

  @fixtures Path.expand("../fixtures/recordings", __DIR__)
  @at 1_795_216_285_745_000
  @hour 3_600_000_000

  defp read(name), do: @fixtures |> Path.join(name) |> Tlog.Reader.stream!() |> Enum.to_list()
  defp tlog(times), do: for(at <- times, into: <<>>, do: <<at::64, heartbeat()::binary>>)

  defp decode(data) do
    {items, decoder} = Tlog.Decoder.push(Tlog.Decoder.new(), data)
    items ++ Tlog.Decoder.finish(decoder)
  end

  defp times(data), do: for(%Frame{at: at} <- decode(data), do: at)

  for name <- ["nanoseconds.tlog", "all-2pow63.tlog"] do
    test "#{name}: no record has a time, and the file says why" do
      assert [%Tlog.Damage{kind: :untimed, offset: 0, bytes: 1633} = damage] = read(unquote(name))
      assert Tlog.Damage.format(damage) =~ "microseconds since 1970, not nanoseconds"
    end
  end

  test "first-zero.tlog, clock-set.tlog: what can be a time is one" do
    assert [0, second | _] = for(%Frame{at: at} <- read("first-zero.tlog"), do: at)
    assert second > 1_600_000_000_000_000
    assert [1_000_000 | _] = times = for(%Frame{at: at} <- read("clock-set.tlog"), do: at)
    assert times == Enum.sort(times)
  end

  test "impossible times before the first possible one cost their records, later ones only their times" do
    assert [
             %Tlog.Damage{kind: :untimed, offset: 0, bytes: 58},
             %Frame{at: @at},
             %Frame{at: @at},
             %Frame{at: last}
           ] =
             decode(tlog([0xFFFFFFFFFFFFFFFF, @at * 1000, @at, @at * 1000, @at + 5]))

    assert last == @at + 5
  end

  test "time goes on for a recorder whose clock went back to 1970" do
    assert times(tlog([@at, 5_000_000, 5_000_000 + @hour, @at + 2 * @hour])) ==
             [@at, @at, @at + @hour, @at + 2 * @hour]
  end

  test "whatever stands there, every time is between 1970 and 2100" do
    :rand.seed(:exsss, {1, 2, 3})

    for _ <- 1..500 do
      times = for _ <- 1..5, do: :rand.uniform(Bitwise.bsl(1, :rand.uniform(64))) - 1
      assert Enum.all?(times(tlog(times)), &(&1 in 0..4_102_444_800_000_000))
    end
  end

  describe "a raw log" do
    test "is not a tlog" do
      assert [%Tlog.Damage{kind: :raw} = damage] = read("raw.rlog")
      assert Tlog.Damage.format(damage) =~ "raw MAVLink log, not a tlog"
    end

    test "nor if it begins in the middle of a frame, comes in pieces, or has unknown messages" do
      raw = String.duplicate(heartbeat() <> attitude(), 5)

      for cut <- 1..40 do
        bytes = binary_part(raw, cut, byte_size(raw) - cut)

        {items, decoder} =
          Enum.flat_map_reduce(for(<<b <- bytes>>, do: <<b>>), Tlog.Decoder.new(), &Tlog.Decoder.push(&2, &1))

        assert %Tlog.Damage{kind: :raw} = List.last(items)
        assert Tlog.Decoder.finish(decoder) == []
      end

      assert [%Tlog.Damage{kind: :raw}] = decode(unknown() <> unknown() <> raw)
    end

    test "a tlog that has lost a time is still one" do
      assert [%Frame{}, %Tlog.Damage{kind: :damaged}, %Frame{}] =
               decode(tlog([@at]) <> heartbeat() <> tlog([@at]))
    end
  end
end
