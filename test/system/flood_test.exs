defmodule Aerie.System.FloodTest do
  @moduledoc "A vehicle sends thousands of texts a second, and its other events still reach NATS."

  use Aerie.SystemCase, async: true

  alias Aerie.Base.Store
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir

  @texts 9_000

  test "a flood of texts displaces no event, and is reported as a number", %{tmp_dir: folder} do
    %{gateway: gateway} = start_gateway(folder, links: ["tcpin:127.0.0.1:0"])
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, link_port(gateway, "link-1"), [:binary, active: true])
    send = &(:ok = :gen_tcp.send(socket, MavCodec.encode(&1, system: 1, component: 1)))

    send.(heartbeat(81))
    eventually(fn -> Store.vehicle(gateway, {"main", 1}) end, "the vehicle is known")

    begun = System.monotonic_time(:second)
    session = Aerie.Base.Names.whereis(gateway, :session, {"main", 1})
    link = fn -> MavRouter.Link.snapshot(gateway, "link-1").counters end

    # As fast as they are taken: what a link or an inbox that is full drops is another test's. In between it is armed and disarmed, and
    # reports an emergency.
    for n <- 1..@texts do
      send.(%M.Statustext{severity: 6, text: "flood #{n}"})
      if rem(n, 300) == 0, do: send.(heartbeat(if(rem(n, 600) == 0, do: 81, else: 81 + 128)))
      if rem(n, 1000) == 0, do: send.(%M.Statustext{severity: 0, text: "help #{n}"})

      if rem(n, 100) == 0 do
        # The first heartbeat, and what was sent in between.
        sent = 1 + n + div(n, 300) + div(n, 1000)
        eventually(fn -> link.().frames_in >= sent end, "#{sent} frames are heard")
        :sys.get_state(session, Aerie.Patience.ms())
      end
    end

    conn = nats_client(gateway)
    id = Store.vehicle(gateway, {"main", 1}).id
    # What does not fit into the inbox is in no event.
    dropped = fn -> Store.counter(gateway, {:vehicle, id, :inbox_dropped}) end

    events =
      eventually(
        fn ->
          events = stream_events(conn)
          texts(events) + told(events) + dropped.() == @texts and events
        end,
        "all texts are accounted for"
      )

    assert told(events) == Store.counter(gateway, {:vehicle, id, :events_suppressed})
    # The budget of `Aerie.Vehicle.Events.Detector.Budget`, whatever time this machine took.
    assert told(events) > 0
    assert texts(events) <= 60 + 2 * (System.monotonic_time(:second) - begun + 1)
    types = Enum.frequencies_by(events, & &1["type"])
    assert %{"armed" => 15, "disarmed" => 15} = types
    assert for(%{"data" => %{"text" => "help " <> n}} <- events, do: n) == for(n <- 1..9, do: "#{n}000")
    # The sequence has no gaps: nothing was dropped on the way.
    seqs = for %{"vehicle" => ^id, "seq" => seq} <- events, do: seq
    assert seqs == Enum.to_list(1..length(seqs))
  end

  defp texts(events),
    do: Enum.count(events, &match?(%{"type" => "statustext", "data" => %{"text" => "flood" <> _}}, &1))

  defp told(events),
    do: Enum.sum(for %{"type" => "events.suppressed", "data" => %{"count" => n}} <- events, do: n)

  defp heartbeat(base_mode),
    do: %M.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: base_mode,
      custom_mode: 0,
      system_status: 4,
      mavlink_version: 3
    }
end
