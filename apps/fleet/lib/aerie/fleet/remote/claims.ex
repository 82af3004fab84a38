defmodule Aerie.Fleet.Remote.Claims do
  @moduledoc """
  The ids of commands in the bucket `fleet_commands`, where all gateways of a NATS server see which of them sends a
  command, and what became of it.
  """

  alias Aerie.Base.Names
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Shadow.Documents
  alias Aerie.Fleet.Shadow.Store.Buckets

  @doc "Claims a command's id (`c:Aerie.Control.Commands.Gateways.claim/4`)."
  @spec claim(Names.gateway(), String.t(), String.t(), pos_integer()) ::
          :ok | {:taken, %{by: String.t(), result: Result.t() | nil}} | {:error, String.t()}
  def claim(gateway, vehicle, id, timeout_ms) do
    case Documents.nats(gateway) do
      {conn, environment} ->
        value = JSON.encode!(%{"by" => Documents.instance(gateway)})

        case Buckets.claim_command(conn, environment, {vehicle, id}, value, timeout_ms) do
          :ok -> :ok
          {:taken, text} -> taken(text, id, Documents.instance(gateway))
          error -> error
        end

      nil ->
        {:error, "NATS is away"}
    end
  end

  # Our own claim, of a command that our ledger has and knows as not sent.
  defp taken(text, id, me) do
    case JSON.decode(text) do
      {:ok, %{"by" => ^me} = claim} when not is_map_key(claim, "result") -> :ok
      {:ok, %{"by" => by} = claim} when is_binary(by) -> {:taken, %{by: by, result: result(claim, id)}}
      _other -> {:taken, %{by: "unnamed", result: nil}}
    end
  end

  defp result(%{"result" => word} = claim, id) when is_binary(word) do
    with {:ok, status} <- Result.status(word) do
      reason = if is_binary(claim["reason"]), do: claim["reason"]
      Result.new(id, status, reason, %{"gateway" => claim["by"]})
    else
      :error -> nil
    end
  end

  defp result(_claim, _id), do: nil

  @doc "Says what became of a command; without it another gateway says `unknown`."
  @spec done(Names.gateway(), String.t(), Result.t()) :: :ok
  def done(gateway, vehicle, result) do
    _ =
      with {conn, environment} <- Documents.nats(gateway) do
        claim = %{
          "by" => Documents.instance(gateway),
          "result" => Atom.to_string(result.status),
          "reason" => result.reason && String.slice(result.reason, 0, 256)
        }

        Nats.pub(
          conn,
          Buckets.command_subject(environment, {vehicle, result.id}),
          JSON.encode_to_iodata!(claim)
        )
      end

    :ok
  end
end
