defmodule Aerie.Console.OpsBrowserTest do
  use Aerie.ConsoleCase, async: true

  @moduletag :chromium

  @tag Aerie.Browser.long()
  test "inspector, system and their neighbours, on a phone and on a desk" do
    [console: console] = start_console()
    put_link(console, "radio", %{diagnosis: [], peers: [], sources: %{}})

    put_vehicle(console, "VID-007", [], %{
      key: {"main", 7},
      system_id: 7,
      collision: %{at: 1, sign: :position, links: [["a"], ["b"]]}
    })

    start_supervised!({Task, fn -> talk(console.gateway, 0) end})
    assert browse(console, "ops.mjs") =~ "ok"
  end

  # A vehicle that sends its attitude.
  defp talk(gateway, n) do
    bytes =
      MavCodec.encode(%MavCodec.Messages.Attitude{time_boot_ms: n, roll: 0.5},
        system: 7,
        component: 1,
        seq: rem(n, 256)
      )

    {frames, _parser} =
      MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, System.os_time(:microsecond))

    MavRouter.Recorder.link_frames(gateway, "radio", frames)
    Process.sleep(100)
    talk(gateway, n + 1)
  end
end
