defmodule MavRouter.Endpoints.EndpointRulesTest do
  @moduledoc "Rules of an endpoint: filters, rate limits, bounds."
  use Aerie.EndpointCase, async: true

  setup c, do: {:ok, v: vehicle(c.gateway, "v", 1), w: vehicle(c.gateway, "w", 2)}

  test "filters work in both directions, by message, system, component and source", c do
    out = client(c.gateway, "out", 254, out: %{block_messages: ["ATTITUDE"], block_sources: ["w"]})
    into = client(c.gateway, "in", 253, in: %{allow_messages: ["HEARTBEAT"]})
    got([c.v, c.w, out, into])
    beat = heartbeat(1, seq: 1)
    say(c.v, [attitude(1, 1), beat])
    say(c.w, heartbeat(2, seq: 1))
    say(into, message(command(1), 253, 190))

    assert %{"out" => [^beat], "v" => []} =
             Map.update!(got([out, c.v]), "v", &(&1 -- [heartbeat(2, seq: 1)]))

    assert %{filtered_out: 2} = counted(c.gateway, "out").counters
    assert %{filtered_in: 1} = counted(c.gateway, "in").counters
  end

  test "rate limits count each message of each component separately", c do
    slow = client(c.gateway, "slow", 254, rate_limits: %{"ATTITUDE" => 0.001})
    got(slow)
    for n <- 1..5, do: say(c.v, attitude(1, n))
    for n <- 1..5, do: say(c.w, attitude(2, n))
    say(c.v, heartbeat(1, seq: 3))
    expected = [attitude(1, 1), attitude(2, 1), heartbeat(1, seq: 3)]
    assert %{"slow" => ^expected} = got(slow)
    assert counted(c.gateway, "slow").counters.limited == 8
  end

  test "frames for an endpoint that takes none are dropped, and counted by class", c do
    lazy = self()
    {:ok, endpoint} = LocalEndpoint.attach(c.gateway, id: "lazy")
    for n <- 1..5_000, do: deliver(c.gateway, "v", parse(attitude(1, n)))

    assert %{counters: %{dropped_state: 904, frames_out: 4_096}, waiting: 4_096} =
             counted(c.gateway, "lazy")

    assert Process.info(lazy, :message_queue_len) |> elem(1) >= 4_096
    :ok = Endpoint.taken(endpoint, 4_096)
    deliver(c.gateway, "v", parse(attitude(1, 1)))
    assert %{counters: %{frames_out: 4_097}} = counted(c.gateway, "lazy")

    assert {:error, "there is an endpoint lazy already"} =
             Task.async(fn -> LocalEndpoint.attach(c.gateway, id: "lazy") end)
             |> Task.await(Aerie.Patience.ms())

    :ok = LocalEndpoint.detach(endpoint)
    assert counted(c.gateway, "lazy") == nil
    # What it says now is heard by nobody.
    assert {%{delivered: 0, unclaimed: 1}, _cache} = LocalEndpoint.ingress(endpoint, parse(heartbeat(44)))
    assert Router.route(c.gateway, {"main", 44}) == nil
  end
end
