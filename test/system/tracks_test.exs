defmodule Aerie.System.TracksTest do
  @moduledoc "An ArduPilot, a PX4 and an iNav while the gateway is killed: their tracks have both parts and the gap."

  use Aerie.RunCase, async: true

  import Aerie.SystemCase

  alias SimVehicle.Msp

  @moduletag :tmp_dir

  setup %{tmp_dir: folder} do
    [http, one, two] = [free_tcp_port(), free_udp_port(), free_udp_port()]
    msp = start_supervised!({Msp, [firmware: :inav, uid: 7]})

    config =
      config_file(folder,
        links: [
          %{id: "one", url: "udpin:127.0.0.1:#{one}"},
          %{id: "two", url: "udpin:127.0.0.1:#{two}"},
          %{id: "msp", url: "msp:tcp:127.0.0.1:#{Msp.port(msp)}?sysid=7"}
        ],
        http: %{port: http},
        nats: %{mode: :off}
      )

    for {firmware, system, port} <- [{:ardupilot, 1, one}, {:px4, 2, two}] do
      options = [system: system, link: "udpout:127.0.0.1:#{port}", script: SimVehicle.Pilot.pattern(system)]
      start_supervised!({SimVehicle, fast_vehicle(firmware) ++ options}, id: {:sim, system})
    end

    %{config: config, http: http, folder: folder}
  end

  # The seconds at which each vehicle has samples, and whether it was in the air at some.
  defp tracks(http) do
    with %{"tracks" => tracks} <- api(http, "/api/tracks") do
      for %{"vehicle" => id, "samples" => samples} <- tracks, into: %{}, do: {id, samples}
    end
  end

  defp flying?(samples, after_it \\ ""),
    do: Enum.any?(samples || [], &(&1["in_air"] and &1["lat"] != nil and &1["at"] > after_it))

  test "both parts and the gap", %{config: config, http: http, folder: folder} do
    run = open(["--config", config, "--quiet"])

    before =
      eventually(
        fn ->
          with %{"VID-001" => one, "VID-002" => two, "VID-007" => [_ | _]} = found <- tracks(http),
               true <- flying?(one) and flying?(two),
               do: found,
               else: (_not_yet -> nil)
        end,
        "both fly, and the iNav is heard",
        started_by()
      )

    kill_9(config)
    await_exit(run)
    killed = DateTime.to_iso8601(DateTime.utc_now())
    open(["--config", config, "--quiet"])

    now =
      eventually(
        fn ->
          with %{"VID-001" => one, "VID-002" => two, "VID-007" => [_ | _]} = found <- tracks(http),
               true <- flying?(one, killed) and flying?(two, killed),
               do: found,
               else: (_not_yet -> nil)
        end,
        "both fly on",
        started_by()
      )

    for {id, samples} <- before do
      # Nothing that was read before is lost, and the rest is later than the kill.
      assert Enum.take(now[id], length(samples)) == samples
    end

    {first, second} = Enum.split_while(now["VID-001"], &(&1["at"] <= killed))
    assert [[_ | _], [_ | _]] = [first, second]
    {:ok, last, 0} = DateTime.from_iso8601(List.last(first)["at"])
    {:ok, again, 0} = DateTime.from_iso8601(hd(second)["at"])
    # A gateway writes its first sample three seconds after its start.
    assert DateTime.diff(again, last, :millisecond) > 2_500
    assert [_file | _] = Path.wildcard(Path.join(folder, "tracks/*.tracks"))
  end
end
