defmodule Aerie.Fleet.AsyncAPI.Schemas do
  @moduledoc "The schemas of `docs/asyncapi.json` by their names. Pure."

  import Aerie.Base.Json.Schema

  alias Aerie.Fleet.AsyncAPI.Requests
  alias Aerie.Base.Json.Object
  alias Aerie.Fleet.Bridge.Events.Gaps
  alias Aerie.Fleet.Remote.Message
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.{Command, Event}
  alias Aerie.Vehicle.State.Fields
  alias Aerie.Vehicle.State.Groups

  @type t :: Aerie.Base.Json.Schema.t()

  @doc "All schemas."
  @spec all() :: %{String.t() => t()}
  def all do
    [states(), events(), commands(), Requests.schemas(), buckets(), headers(), Requests.answers()]
    |> Enum.concat()
    |> Map.new()
  end

  defp states do
    groups =
      for group <- Groups.all(),
          do: {"state.#{group.name}", state(group.name, group.title, Fields.Schema.group(group))}

    [
      {"state.gateway", state(:gateway, "What a gateway says of a vehicle.", Object.schema(Message.fields()))}
      | groups
    ]
  end

  defp state(name, title, data) do
    properties = %{
      vehicle: token(),
      group: %{const: name},
      gateway: described(%{type: :string}, "the gateway that published it"),
      epoch: epoch(),
      time: described(stamp(), "when its data was received"),
      time_boot_ms: boot(),
      data: data
    }

    described(
      object(properties, [:vehicle, :group, :gateway, :time, :time_boot_ms, :data], open: true),
      title
    )
  end

  defp events do
    gap =
      object(Map.new(~w(epoch from to lost)a, &{&1, %{type: :integer, minimum: 1}}), ~w(epoch from to lost)a,
        open: true
      )

    lost =
      event(Gaps.type(), "Events that a bounded store had no room for; it has no number of its own.", gap, %{
        type: :null
      })

    Map.to_list(Fields.Schema.shared()) ++
      [
        {"event.#{Gaps.type()}", lost}
        | for(
            type <- Event.Types.all(),
            do:
              {"event.#{type.type}",
               event(type.type, type.when, Fields.Schema.event(type), %{type: :integer, minimum: 1})}
          )
      ]
  end

  defp event(type, meaning, data, seq) do
    properties = %{
      id: described(%{type: :string, minLength: 1}, "of two messages with one id, the second is a copy"),
      vehicle: described(%{type: :string}, "the vehicle, or the gateway of an event of its own"),
      type: %{const: type},
      epoch: epoch(),
      seq: described(seq, "1, 2, 3 … for each vehicle in an epoch"),
      time: described(stamp(), "when the gateway received what shows it"),
      time_boot_ms: boot(),
      data: data
    }

    described(
      object(properties, [:id, :vehicle, :type, :seq, :time, :time_boot_ms, :data], open: true),
      meaning
    )
  end

  defp epoch, do: described(%{type: :integer, minimum: 1}, "grows with each start of the gateway")
  defp boot, do: described(%{type: [:integer, :null], minimum: 0}, "the vehicle's own clock", "ms")
  defp stamp, do: %{type: :string, format: :"date-time"}

  defp commands do
    cancel =
      object(%{id: described(token(), "of the command or request that is cancelled")}, [:id], open: true)

    requests =
      for type <- Command.Types.all(), do: {"command.#{type.name}", Command.Schema.envelope(type, id?: true)}

    [{"command.cancel", cancel}, {"progress", progress()} | requests] ++ Map.to_list(Command.Schema.shared())
  end

  defp progress do
    object(
      %{
        id: token(),
        progress:
          described(
            %{type: [:number, :null], minimum: 0, maximum: 1},
            "the share that is done; null if unknown"
          ),
        text: described(%{type: [:string, :null]}, "a sentence for people")
      },
      [:id, :progress],
      open: true
    )
  end

  defp buckets do
    [
      {"desired", Shadow.Document.Schema.document()},
      {"reported", Shadow.Document.Schema.reported()},
      {"gateway",
       object(
         %{
           gateway: %{type: :string},
           seen:
             described(
               %{type: :object, additionalProperties: %{type: :integer}},
               "the last numbers of other gateways' signs of life (`Aerie-Seal`): this one was written later"
             )
         },
         [:gateway],
         open: true
       )},
      {"owner",
       described(%{type: :string}, "the instance of `fleet_leases`, or gateway-ID for the gateway aboard")},
      {"claim",
       object(
         %{
           by: described(%{type: :string}, "the instance of the gateway"),
           result: %{enum: for({status, _meaning, _done?} <- Command.Result.table(), do: status)},
           reason: %{type: [:string, :null]}
         },
         [:by],
         open: true
       )}
    ]
  end

  defp headers do
    backfill = described(%{const: "true"}, "it comes late: history, which must not be shown as live")

    [
      {"headers.published", object(%{"Aerie-Backfill" => backfill}, [], open: true)},
      {"headers.event",
       object(
         %{"Aerie-Backfill" => backfill, "Nats-Msg-Id" => described(%{type: :string}, "the id of the event")},
         [],
         open: true
       )},
      {"headers.request",
       object(
         %{
           "Aerie-Signature" =>
             described(%{type: :string}, "who asks, and that nobody changed it (docs/policy.md)"),
           "Aerie-Deadline" => described(%{type: :string}, "of an unsigned command without one in its body"),
           "Aerie-Source" => described(%{type: :string}, "of an unsigned command without one in its body")
         },
         [],
         open: true
       )}
    ]
  end
end
