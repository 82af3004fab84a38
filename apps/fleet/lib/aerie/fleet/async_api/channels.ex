defmodule Aerie.Fleet.AsyncAPI.Channels do
  @moduledoc """
  The subjects of NATS that are described: one row each, with its messages. The subjects `hub.…` of a leaf node carry
  the same messages (docs/fleet.md) and are not repeated. Pure.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Fleet.AsyncAPI.Requests
  alias Aerie.Control.Operations
  alias Aerie.Control.Operations.Operation
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Vehicle.Command

  @vehicle "fleet.{environment}.{vehicle}"

  @typedoc """
    * `:action` - what the gateway does: `:send`, `:receive`, or nil for a bucket that it reads and writes, and for
      the inbox
    * `:replies` - the messages of the answer
  """
  @type t :: %{
          id: String.t(),
          address: String.t() | nil,
          action: :send | :receive | nil,
          meaning: String.t(),
          messages: [map()],
          replies: [String.t()]
        }

  @doc "All of them."
  @spec all() :: [t()]
  def all do
    published() ++ commands() ++ operations() ++ buckets() ++ [inbox()]
  end

  defp row(id, address, action, meaning, messages, replies \\ []),
    do: %{id: id, address: address, action: action, meaning: meaning, messages: messages, replies: replies}

  defp message(id, title, more \\ []), do: Map.merge(%{id: id, title: title, schema: id}, Map.new(more))

  defp published do
    groups =
      for group <- Message.state_groups(),
          do: message("state.#{group}", "The state group #{group}.", headers: "headers.published")

    types =
      for type <- Message.event_types(),
          do: message("event.#{type}", "The event #{type}.", headers: "headers.event")

    [
      row(
        "state",
        Message.state_subject("{environment}", "{vehicle}", "{group}"),
        :send,
        "The state of a vehicle by groups, as often as `sampling` says. The stream FLEET_STATE keeps the last of each.",
        groups
      ),
      row(
        "event",
        Message.event_subject("{environment}", %{vehicle: "{publisher}", type: "{type}"}),
        :send,
        "What happened, at least once: the id says whether it is a copy. The stream FLEET_EVENTS keeps them, or one " <>
          "for each vehicle.",
        types
      ),
      row("cmd.progress", "#{@vehicle}.cmd.{command}.progress.{id}", :send, "The progress of a command.", [
        progress()
      ]),
      row(
        "transfer.progress",
        "#{@vehicle}.{area}.{operation}.progress.{id}",
        :send,
        "The progress of a request for parameters, plans, files or logs that has an id.",
        [progress()]
      )
    ]
  end

  defp progress, do: message("progress", "How far it is.")

  defp commands do
    cancel =
      message(
        "command.cancel",
        "Cancels a command, or the reading of parameters, plans, files or logs.",
        signed()
      )

    for(
      type <- Command.Types.all(),
      request = message("command.#{type.name}", type.meaning, signed()),
      do:
        row("cmd.#{type.name}", "#{@vehicle}.cmd.#{type.name}", :receive, type.meaning, [request], [
          "result",
          "refusal"
        ])
    ) ++
      [row("cmd.cancel", "#{@vehicle}.cmd.cancel", :receive, cancel.title, [cancel], ["result", "refusal"])]
  end

  defp signed, do: [headers: "headers.request"]

  defp operations do
    for %{name: name, meaning: meaning} = operation <- Aerie.Fleet.operations() do
      target = if String.starts_with?(name, "operation."), do: "fleet.{environment}.{gateway}", else: @vehicle
      request = message(name, meaning, signed())
      row(name, "#{target}.#{name}", :receive, meaning, [request], replies(operation))
    end
  end

  defp replies(%{transfer?: false} = operation), do: [Operation.answer_name(operation), "refused"]
  defp replies(%{changes?: true}), do: ["result", "refusal"]
  defp replies(operation), do: [Operation.answer_name(operation), "result", "refusal"]

  defp buckets do
    text = [content_type: "text/plain"]

    for {id, key, meaning, more} <- [
          {"desired", "fleet_desired.{environment}.{vehicle}", "The desired document of a vehicle.", []},
          {"reported", "fleet_reported.{environment}.{vehicle}", "The reported document of a vehicle.", []},
          {"gateway", "fleet_leases.{environment}.gateways.{instance}", "The sign of life of a gateway.", []},
          {"owner", "fleet_leases.{environment}.vehicles.{vehicle}", "Which gateway acts on a vehicle.",
           text},
          {"claim", "fleet_commands.{environment}.{vehicle}.{key}",
           "Which gateway sends a command, and what became of it.", []},
          {"plan", "fleet_plans.{hash}", "A .plan file by the SHA-256 of its bytes.", []}
        ],
        do: row("bucket.#{id}", "$KV.#{key}", nil, meaning, [message(id, meaning, more)])
  end

  defp inbox do
    answers = for {name, _schema} <- Requests.answers(), do: message(name, "An answer.")
    row("inbox", nil, nil, "The subject that a request names for its answer.", answers)
  end

  @doc "A row as AsyncAPI has a channel."
  @spec channel(t()) :: map()
  def channel(row) do
    messages = Map.new(row.messages, &{&1.id, %{"$ref": "#/components/messages/#{&1.id}"}})
    names = for [_all, name] <- Regex.scan(~r/\{([a-z]+)\}/, row.address || ""), do: name

    %{address: row.address, description: row.meaning, messages: messages}
    |> Map.merge(
      if names == [],
        do: %{},
        else: %{parameters: Map.new(names, &{&1, %{"$ref": "#/components/parameters/#{&1}"}})}
    )
  end

  @doc "What the gateway does with it."
  @spec operation(t()) :: map()
  def operation(row) do
    operation = %{
      action: row.action,
      channel: %{"$ref": "#/channels/#{row.id}"},
      summary: row.meaning,
      messages: for(%{id: id} <- row.messages, do: %{"$ref": "#/channels/#{row.id}/messages/#{id}"})
    }

    if row.replies == [] do
      operation
    else
      Map.put(operation, :reply, %{
        channel: %{"$ref": "#/channels/inbox"},
        messages: for(id <- row.replies, do: %{"$ref": "#/channels/inbox/messages/#{id}"})
      })
    end
  end

  @doc "The parts of the subjects that are in braces."
  @spec parameters() :: map()
  def parameters do
    areas = for %{name: name} <- Operations.all(), do: String.split(name, ".")
    one_of = fn list -> %{enum: Enum.uniq(list)} end

    %{
      environment: described(%{default: "prod"}, "The `environment` of the gateways' configuration."),
      vehicle: described(%{}, "The vehicle's id: 1 to 64 letters, digits, - and _."),
      publisher:
        described(
          %{},
          "A vehicle's id, or the name of a gateway for its own events, such as gateway-VID-001."
        ),
      gateway: described(%{}, "The name of a gateway, such as gateway-VID-001."),
      group: described(one_of.(Message.state_groups()), "The state group."),
      type:
        described(
          one_of.(Message.event_types()),
          "The type of the event. One with a dot is two tokens of the subject."
        ),
      command: described(one_of.(Command.Types.names()), "The type of the command."),
      area: described(one_of.(Enum.map(areas, &hd/1)), "The area of the request."),
      operation: described(one_of.(Enum.map(areas, &List.last/1)), "The operation of the request."),
      id: described(%{}, "The id of the request: 1 to 64 letters, digits, - and _."),
      instance: described(%{}, "A start of a gateway."),
      key: described(%{}, "The command's id in base64 for URLs, without padding."),
      hash: described(%{}, "64 hexadecimal digits.")
    }
  end
end
