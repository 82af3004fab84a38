defmodule Aerie.Fleet.Bridge.Commands.Operation do
  @moduledoc """
  Requests on `fleet.{environment}.{vehicle}.{area}.{action}` other than commands: the operations of
  `Aerie.Control.Operations`, such as `params.set`. `docs/transfers.md` describes them.
  """

  alias Aerie.Base.{Json, Names}
  alias Aerie.Base.Settings.Field
  alias Aerie.Control.Operations
  alias Aerie.Control.Operations.Operation
  alias Aerie.Control.Policy.Roles
  alias Aerie.Vehicle.Command.{Error, Refusal, Result}

  # A message of NATS is a mebibyte at most by default.
  @max_bytes 1_000_000
  # In base64 it is a third larger.
  @max_file div(@max_bytes * 7, 10)
  # What is read of the envelope, or given by the subject.
  @envelope ~w(vehicle type source)

  @doc "The largest body and the largest reply in bytes."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "The areas: what is subscribed to beside commands."
  @spec areas() :: [String.t(), ...]
  defdelegate areas, to: Operations

  @doc "Whether there is an operation of this name."
  @spec known?(String.t()) :: boolean()
  def known?(name), do: match?({:ok, _operation}, Operations.fetch(name))

  @doc "The reply to a request of somebody for an operation by its name; progress goes to `progress`."
  @spec answer(Names.gateway(), name :: String.t(), map(), Roles.source(), {pid(), term()}) :: map()
  def answer(gateway, name, request, source, progress) do
    says = if is_binary(request["source"]) and byte_size(request["source"]) <= 256, do: request["source"]
    options = [as: source, via: "nats", progress: progress, says: says]

    with {:ok, operation} <- operation(name),
         {:ok, input} <- parse(operation, Map.drop(request, @envelope)) do
      context = %{
        gateway: gateway,
        vehicle: request["vehicle"],
        by: nil,
        options: Operation.options(input) ++ options,
        format: "json",
        max_bytes: @max_file
      }

      operation.module.run(input, context)
    end
    |> plain(request["id"])
    |> bounded(request["id"])
  end

  defp operation(name) do
    with :error <- Operations.fetch(name) do
      [area | _action] = String.split(name, ".")
      {:error, [Error.new("subject", "one of #{Enum.join(Operations.names(area), ", ")}", name)]}
    end
  end

  # Without an id of the sender a copy of what changes the vehicle would be something new.
  defp parse(%{changes?: true} = operation, request), do: Operation.parse(operation, request, required: [:id])
  defp parse(operation, request), do: Operation.parse(operation, request)

  defp plain({:ok, %Result{} = result}, _id), do: Result.plain(result)
  # An unknown vehicle is reported before there is an id.
  defp plain({:error, %Result{} = result}, id), do: Result.plain(%{result | id: id || result.id})

  defp plain({:ok, {:bytes, bytes, path}}, id),
    do: plain({:ok, %{path: path, data: Base.encode64(bytes)}}, id)

  defp plain({:ok, value}, id), do: Map.merge(%{"id" => id, "result" => "completed", "reason" => nil}, value)
  defp plain({:pending, id}, _id), do: %{"id" => id, "result" => nil, "reason" => "it is under way"}

  defp plain({:error, {:invalid, error}}, id), do: plain({:error, [error]}, id)

  defp plain({:error, errors}, id) do
    shown = for error <- errors, do: error |> Map.from_struct() |> Map.take([:key, :expected, :got])

    %{
      "id" => short(id),
      "result" => "rejected",
      "rule" => "malformed",
      "reason" => Enum.join(errors, "; "),
      "errors" => shown
    }
  end

  defp short(id), do: if(is_binary(id) and byte_size(id) <= 64, do: id)

  defp bounded(reply, id) do
    body = Json.encode_to_iodata!(reply)

    if IO.iodata_length(body) <= @max_bytes do
      reply
    else
      reason = Refusal.text(:reply_large, bytes: IO.iodata_length(body), most: @max_bytes)
      %{"id" => short(id), "result" => "failed", "rule" => "size", "reason" => reason}
    end
  end

  # --- Schemas

  @doc "The JSON Schema of a request."
  @spec request_schema(Operation.t()) :: Json.Schema.t()
  def request_schema(%{request: nil, transfer?: true, name: name, changes?: changes?} = operation) do
    envelope = %{
      vehicle: Json.Schema.described(Json.Schema.token(), "if given, that of the subject"),
      type: %{const: name},
      source: Json.Schema.described(%{type: :string}, "a remark")
    }

    common = for field <- Operation.common(operation), do: %{field | required: changes? and field.key == :id}
    properties = for field <- common, into: envelope, do: {field.key, Field.schema(field)}
    Operation.schema(operation, properties, if(changes?, do: [:id], else: []))
  end

  def request_schema(%{once: {key, _when, _reason}} = operation),
    do: operation |> Operation.schema(%{}, []) |> demanding(String.to_existing_atom(key))

  def request_schema(operation), do: Operation.schema(operation, %{}, [])

  # The same with a key that must be there.
  defp demanding(%{oneOf: kinds} = schema, key), do: %{schema | oneOf: Enum.map(kinds, &demanding(&1, key))}

  defp demanding(%{properties: properties} = schema, key) do
    property = Map.update!(properties[key], :type, &(&1 |> List.wrap() |> List.delete(:null) |> hd()))
    required = Enum.sort_by([key | Map.get(schema, :required, [])], &to_string/1)
    Map.merge(schema, %{properties: %{properties | key => property}, required: required})
  end

  @doc "The JSON Schema of the reply to one that reads, or that has an answer of its own."
  @spec reply_schema(Operation.t()) :: Json.Schema.t()
  def reply_schema(%{transfer?: false} = operation),
    do: Operation.answer_schema(operation, %{result: %{const: "ok"}})

  def reply_schema(operation) do
    read = %{
      id: Json.Schema.nullable(Json.Schema.token()),
      result: %{const: "completed"},
      reason: %{type: :null}
    }

    Operation.answer_schema(operation, read)
  end
end
