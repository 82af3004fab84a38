defmodule Aerie.Api.Rest.Commands do
  @moduledoc """
  Commands over REST: `Aerie.Control.Commands` in the name of a key, and the answer for each outcome.

  `Aerie.Access.Principals` says as whom somebody commands. A signature replaces the key (`Aerie.Control.Policy.Roles.Signature`).
  """

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.{Commands, Policy}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.HTTP.Error

  @typedoc "The header `Aerie-Signature` (nil: none), and the body as it was sent."
  @type signed :: %{header: String.t() | nil, body: binary()}

  # Shorter than the connection's time-out.
  @max_wait_s 20

  @doc """
  Gives a command and waits for its result for at most `wait` seconds (a text from the query): 200 with the result, 202 while it is under way, or the
  error that corresponds to its result.
  """
  @spec submit(term(), String.t(), map(), String.t() | nil, Roles.source(), signed()) ::
          {:ok, 200 | 202, map()} | {:error, Error.t()}
  def submit(gateway, vehicle, object, wait, source, signed) do
    with {:ok, wait_ms} <- wait_ms(wait),
         :ok <- same(object, vehicle),
         {:ok, source} <- who(gateway, vehicle, object, source, signed) do
      options = [via: "rest", wait_ms: wait_ms]

      case Commands.submit(gateway, Map.put(object, "vehicle", vehicle), source, options) do
        {:ok, result} -> outcome(result)
        {:pending, id} -> {:ok, 202, %{"id" => id, "vehicle" => vehicle, "state" => "under_way"}}
        {:error, errors} -> {:error, Error.malformed(errors)}
      end
    end
  end

  defp outcome(result) do
    case Error.of_result(result) do
      nil -> {:ok, 200, Result.plain(result)}
      error -> {:error, error}
    end
  end

  @doc "The state of a command: its result (`state` is `done`), or its progress (`under_way`)."
  @spec state(term(), String.t(), String.t()) :: {:ok, map()} | {:error, Error.t()}
  def state(gateway, vehicle, id) do
    case Commands.state(gateway, vehicle, id) do
      {:ok, result} ->
        {:ok, Map.put(Result.plain(result), "state", "done")}

      {:under_way, job} ->
        {:ok,
         %{
           "id" => id,
           "vehicle" => job.vehicle,
           "type" => job.type,
           "source" => job.source,
           "progress" => job.progress,
           "state" => "under_way"
         }}

      nil ->
        {:error, Error.new(:not_found, "no command of this vehicle has this id")}

      {:error, reason} ->
        {:error, Error.new(:unavailable, reason)}
    end
  end

  @doc "Cancels a command."
  @spec cancel(term(), String.t(), String.t(), Roles.source()) :: {:ok, map()} | {:error, Error.t()}
  def cancel(gateway, vehicle, id, source) do
    case Commands.cancel(gateway, vehicle, id, source, "rest") do
      :ok -> {:ok, %{"id" => id, "state" => "cancelling"}}
      {:error, :unknown, reason} -> {:error, Error.new(:not_found, reason)}
      {:error, :role, reason} -> {:error, Error.new(:forbidden, reason)}
      {:error, :impossible, reason} -> {:error, Error.new(:conflict, reason)}
    end
  end

  # The signer of a command is its source, whichever key the request has.
  defp who(_gateway, _vehicle, _object, source, %{header: nil}), do: {:ok, source}

  defp who(gateway, vehicle, object, _source, %{header: header, body: body}) do
    subject = "fleet.#{Aerie.Fleet.Bridge.environment(gateway)}.#{vehicle}.cmd.#{object["type"]}"
    envelope = Map.put(object, "vehicle", vehicle)

    with {:deny, _signature_or_policy, reason} <- Policy.signer(gateway, header, subject, body, object["id"]) do
      Commands.turned_away(gateway, envelope, nil, "rest", {:deny, :signature, reason})
      {:error, %{Error.new(:forbidden, reason) | details: %{"result" => "denied", "rule" => "signature"}}}
    end
  end

  @fields Object.fields([
            {:type, :text, nil, "name of the command"},
            {:lacks, {:one_of, [:firmware, :permission]}, nil, "why it may not be given; null if it may"},
            {:permission, :text, nil, "the permission that is missing"},
            {:reason, :text, nil, "a sentence for people"}
          ])

  @doc "The table of commands: for forms, and for programs that want to know what can be commanded."
  @spec types() :: [map()]
  def types, do: for(type <- Command.types(), do: Object.show(Command.type_fields(), type))

  @doc "The fields of an offer."
  @spec offer_fields() :: [Object.t()]
  def offer_fields, do: @fields

  @doc """
  Each command of the table, and why it need not be offered: `lacks` is `firmware` or `permission`, null if it may be
  given. Whether it would be carried out now is another matter. nil: there is no such vehicle.
  """
  @spec offers(term(), vehicle :: String.t(), Roles.source()) :: map() | nil
  def offers(gateway, id, source) do
    with %{} = vehicle <- Aerie.Fleet.vehicle(gateway, id),
         do: %{
           "commands" =>
             for(%{name: name} <- Command.types(), do: offer(name, Commands.lacks(vehicle, name, source)))
         }
  end

  defp offer(type, nil), do: %{"type" => type, "lacks" => nil, "permission" => nil, "reason" => nil}

  defp offer(type, {:firmware, reason}),
    do: %{"type" => type, "lacks" => "firmware", "permission" => nil, "reason" => reason}

  defp offer(type, {:permission, permission, reason}),
    do: %{"type" => type, "lacks" => "permission", "permission" => permission, "reason" => reason}

  @doc "How long to wait for a result, from the query's text."
  @spec wait_ms(String.t() | nil) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def wait_ms(nil), do: {:ok, @max_wait_s * 1000}

  def wait_ms(text) do
    case Integer.parse(text) do
      {seconds, ""} when seconds in 0..@max_wait_s -> {:ok, seconds * 1000}
      _other -> Error.invalid("wait: expected 0 to #{@max_wait_s} seconds")
    end
  end

  defp same(%{"vehicle" => other}, vehicle) when other != vehicle,
    do: Error.invalid("vehicle: the path names another one than the body")

  defp same(_object, _vehicle), do: :ok
end
