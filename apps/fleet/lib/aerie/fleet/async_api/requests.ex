defmodule Aerie.Fleet.AsyncAPI.Requests do
  @moduledoc "What can be asked for over NATS besides commands, with the schemas of requests and answers. Pure."

  import Aerie.Base.Json.Schema

  alias Aerie.Control.Operations
  alias Aerie.Control.Operations.Operation
  alias Aerie.Fleet
  alias Aerie.Fleet.Bridge.Commands.Operation, as: Answers
  alias Aerie.Fleet.Operations.Schema
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Command

  @type t :: Aerie.Base.Json.Schema.t()

  @doc "The schemas of requests, and those that they refer to, by their names."
  @spec schemas() :: [{String.t(), t()}]
  def schemas do
    shared = [Operations.shared(), Shadow.Document.Schema.shared(), Schema.shared()]

    Enum.flat_map(shared, &Map.to_list/1) ++
      for operation <- Fleet.operations(), do: {operation.name, Answers.request_schema(operation)}
  end

  @doc "The schemas of answers by their names."
  @spec answers() :: [{String.t(), t()}]
  def answers do
    refused =
      object(
        %{
          result: %{const: "refused"},
          rule: described(%{type: :string}, "malformed, role, conflict, limit, rate, signature, …"),
          reason: %{type: :string},
          token: %{type: [:string, :null]}
        },
        [:result, :rule, :reason],
        open: true
      )

    own =
      for operation <- Fleet.operations(),
          not (operation.transfer? and operation.changes?),
          uniq: true,
          do: {Operation.answer_name(operation), Answers.reply_schema(operation)}

    [{"result", Command.Schema.result()}, {"refusal", refusal()}, {"refused", refused} | own]
  end

  # A request that was not understood, or refused for its size.
  defp refusal do
    wrong =
      object(
        %{key: %{type: :string}, expected: %{type: :string}, got: %{type: [:string, :null]}},
        [:key, :expected],
        open: true
      )

    object(
      %{
        id: %{type: [:string, :null]},
        result: %{enum: ~w(rejected denied failed)},
        rule: described(%{type: :string}, "malformed, size, signature, policy, busy, …"),
        reason: %{type: :string},
        errors: %{type: :array, items: wrong}
      },
      [:id, :result, :rule, :reason],
      open: true
    )
  end
end
