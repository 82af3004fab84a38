defmodule Aerie.Link.DamageTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import ExUnit.CaptureLog

  alias Aerie.Store
  alias Aerie.Link.Counters
  alias Aerie.Link.Damage

  defp counted(crc, incompatible \\ 0, resync \\ 0),
    do: %Counters{crc_errors: crc, incompatible: incompatible, resync_bytes: resync}

  test "the first is told at once, the next ten seconds together, and none when there are none" do
    damage = Damage.new(counted(7))
    assert {nil, damage} = Damage.look(damage, counted(7), 0)

    assert {"what came was damaged: 1 frames with a wrong CRC, " <> _, damage} =
             Damage.look(damage, counted(8), 250)

    assert {nil, damage} = Damage.look(damage, counted(500), 10_249)
    assert {text, damage} = Damage.look(damage, counted(500, 2, 9), 10_250)
    assert text =~ "492 frames with a wrong CRC, 2 with flags that nobody knows, 9 bytes that are no frame"
    assert {nil, _damage} = Damage.look(damage, counted(500, 2, 9), 60_000)
  end

  test "a few bytes between frames are no damage, a stream of them is" do
    damage = Damage.new(counted(0))
    assert {nil, damage} = Damage.look(damage, counted(0, 0, 280), 0)
    assert {"what came was damaged: 0 frames" <> _, _damage} = Damage.look(damage, counted(0, 0, 2_000), 1)
  end

  test "a link logs one line of many damaged frames" do
    gateway = start_parts()
    {id, port} = add_link(gateway, "tcpin:127.0.0.1:0", id: "noisy")
    <<most::binary-size(12), _crc::binary>> = heartbeat(1)

    log =
      capture_log(fn ->
        {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary])
        :ok = :gen_tcp.send(socket, [heartbeat(1) | List.duplicate(most <> "wrong!!", 50)])
        # It is logged before the counters are shown.
        eventually(fn -> Store.link(gateway, id).counters.crc_errors >= 1 end)
      end)

    assert [_before, _once] = String.split(log, "link noisy: what came was damaged")
  end
end
