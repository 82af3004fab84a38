defmodule Aerie.Fleet.AsyncAPI.PayloadsTest do
  @moduledoc "What the gateway publishes is as the schemas say, key by key: of flights of real firmware, and of any messages at all."
  use ExUnit.Case, async: true

  alias Aerie.Base.Json
  alias Aerie.Fleet.{AsyncAPI, Replay}
  alias Aerie.Fleet.Bridge.Events.Gaps
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Remote
  alias Aerie.JsonSchemaCheck
  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.State.Groups
  alias MavCodec.Dialects.All

  @fixtures Path.expand("../../../../../vehicle/test/fixtures", __DIR__)
  @origin %{epoch: 7, gateway: "gateway-VID-001"}
  @second 1_000_000

  setup_all do
    %{document: JSON.decode!(AsyncAPI.text())}
  end

  defp errors(document, name, body),
    do:
      document
      |> JsonSchemaCheck.component(name)
      |> JsonSchemaCheck.errors(JSON.decode!(body), document, closed: true)

  for recording <- ~w(arducopter_flight arducopter_mavlink1 px4_118_failsafes_a arduplane_47_quadplane_vtol) do
    test "state and events of #{recording}", %{document: document} do
      {:ok, flight} = Replay.run(Path.join(@fixtures, unquote(recording) <> ".tlog.gz"))
      assert flight.events != [] and length(flight.samples) > 100

      for event <- flight.events,
          do: assert([] == errors(document, "event.#{event.type}", Message.event(event, 7)))

      for sample <- flight.samples do
        body =
          Message.state(
            sample.vehicle,
            "#{sample.group}",
            sample.data,
            sample.time_boot_ms,
            sample.at,
            @origin
          )

        assert [] == errors(document, "state.#{sample.group}", body)
      end

      for {_id, snapshot} <- flight.snapshots do
        facts = Remote.Message.facts(snapshot, flight.summary.to)

        assert [] ==
                 errors(
                   document,
                   "state.gateway",
                   Message.state("V", "gateway", facts, nil, flight.summary.to, @origin)
                 )
      end
    end
  end

  test "the marker of lost events", %{document: document} do
    record = Gaps.marker("test", {"VID-001", 7, 3, 5}, 1_795_000_000 * @second)
    assert [] == errors(document, "event.events.lost", record.body)
  end

  test "the state after any messages", %{document: document} do
    ids = Enum.filter(All.ids(), &Groups.reads?/1)
    assert length(ids) > 20
    message = :proper_types.tuple([:proper_types.elements(ids), :proper_types.binary()])

    property =
      :proper.forall(:proper_types.list(message), fn messages ->
        state = Enum.reduce(messages, %State{}, &heard/2)

        for {group, %{data: data}} <- state.groups,
            body = Message.state("V", "#{group}", Json.plain(data), 5, 1_795_000_000 * @second, @origin),
            error <- errors(document, "state.#{group}", body),
            reduce: true do
          _all -> flunk("#{group}: #{error}, #{body}")
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300, max_size: 60]) == true,
           inspect(:proper.counterexample(), limit: 60)
  end

  # Longer payloads than PropEr's own, most of them with every field.
  defp heard({id, bytes}, state) do
    {_least, most} = All.length(id)
    payload = binary_part(bytes <> :crypto.hash(:sha512, bytes) <> :binary.copy(<<255>>, most), 0, most)

    with {:ok, message} <- All.decode(id, payload),
         {%State{} = state, _groups} <- State.apply(state, id, message, 1_795_000_000 * @second) do
      state
    else
      _invalid -> state
    end
  end
end
