defmodule DecisionBench do
  @moduledoc """
  What it costs to decide whether a frame may reach vehicles (`MavRouter.Forward.Gate`), in nanoseconds a frame: reads
  of 16 frames, the median of 15 rounds, in this process alone.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.MavlinkPolicy
  alias MavRouter.Forward.Delivery
  alias MavRouter.Forward.Gate
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Forward.Source
  alias MavRouter.Forward.Table
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M

  @gateway :decision_bench
  @reads 2_000
  @frames 16

  def main do
    {:ok, policy} =
      Policy.compile(%{clients: [%{id: "operator", role: :operator}, %{id: "viewer", role: :viewer}]})

    {:ok, store} = Policy.Store.start_link(gateway: @gateway, policy: policy)

    telemetry = [
      %M.Attitude{roll: 0.5},
      %M.GlobalPositionInt{lat: 1},
      %M.SysStatus{load: 3},
      %M.VfrHud{alt: 2.0}
    ]

    IO.puts("\n| what a decision costs | ns a frame |\n|---|---|")
    row("telemetry of a vehicle", telemetry, path(side: :vehicle, heard_vehicle: true), vehicle: true)

    row(
      "telemetry of a vehicle, from this machine",
      telemetry,
      path(side: :vehicle, heard_vehicle: true, commands: true, local: true),
      vehicle: true
    )

    heartbeat = [%M.Heartbeat{type: 6, autopilot: 8}]
    row("an operator's heartbeat", heartbeat, path(side: :client, commands: true, owner: "operator"), [])
    row("a viewer's heartbeat", heartbeat, path(side: :client, commands: true, owner: "viewer"), [])
    GenServer.stop(store)
  end

  defp path(fields) do
    owner = fields[:owner] || "link"

    struct!(
      %Table.Path{
        key: {owner, 1},
        owner: owner,
        side: fields[:side],
        networks: ["main"],
        counters: Counters.new(),
        gateway: @gateway,
        text: "10.0.0.9:14550"
      },
      fields
    )
  end

  defp row(name, messages, path, source) do
    frames = messages |> Stream.cycle() |> Enum.take(@frames) |> Enum.map(&frame/1)

    delivery = %Delivery{
      gateway: @gateway,
      tables: %{policy: MavlinkPolicy, readings: nil},
      forwarding: %{paths: %{path.key => path}, listeners: %{}},
      path: path,
      source: struct!(Source.new(1, 1), source),
      now: 0
    }

    times =
      for _round <- 1..15 do
        {us, _} = :timer.tc(fn -> for _read <- 1..@reads, do: Gate.sort(frames, delivery) end)
        us * 1_000 / (@reads * @frames)
      end

    IO.puts("| #{name} | #{times |> Enum.sort() |> Enum.at(7) |> round()} |")
  end

  defp frame(message) do
    bytes = MavCodec.encode(message, system: 1, component: 1)
    {[%Frame{} = frame], _parser} = Parser.push_datagram(Parser.new(), bytes, 5)
    frame
  end
end
