defmodule MavRouter.Link.Core.DamageLogTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import ExUnit.CaptureLog

  alias Aerie.Base.Store
  alias MavRouter.Link.Core.Counters
  alias MavRouter.Link.Core.DamageLog

  defp counted(crc, incompatible \\ 0, resync \\ 0),
    do: %Counters{crc_errors: crc, incompatible: incompatible, resync_bytes: resync}

  test "the first damage is logged at once, the next ten seconds together, and nothing if there is none" do
    damage = DamageLog.new(counted(7))
    assert {nil, damage} = DamageLog.check(damage, counted(7), 0)

    assert {"received damaged data: 1 frames with a wrong CRC, " <> _, damage} =
             DamageLog.check(damage, counted(8), 250)

    assert {nil, damage} = DamageLog.check(damage, counted(500), 10_249)
    assert {text, damage} = DamageLog.check(damage, counted(500, 2, 9), 10_250)
    assert text =~ "492 frames with a wrong CRC, 2 with unknown flags, 9 bytes outside of frames"
    assert {nil, _damage} = DamageLog.check(damage, counted(500, 2, 9), 60_000)
  end

  test "a few bytes between frames are not damage, a stream of them is" do
    damage = DamageLog.new(counted(0))
    assert {nil, damage} = DamageLog.check(damage, counted(0, 0, 280), 0)

    assert {"received damaged data: 0 frames" <> _, _damage} =
             DamageLog.check(damage, counted(0, 0, 2_000), 1)
  end

  test "a link logs one line of many damaged frames" do
    gateway = start_parts()
    {id, port} = add_link(gateway, "tcpin:127.0.0.1:0", id: "noisy")
    <<most::binary-size(12), _crc::binary>> = heartbeat(1)

    log =
      capture_log(fn ->
        {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary])
        :ok = :gen_tcp.send(socket, [heartbeat(1) | List.duplicate(most <> "wrong!!", 50)])
        # It is logged before the counters are published.
        eventually(fn -> Store.link(gateway, id).counters.crc_errors >= 1 end)
      end)

    assert [_before, _once] = String.split(log, "link noisy: received damaged data")
  end
end
