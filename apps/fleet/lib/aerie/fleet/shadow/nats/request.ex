defmodule Aerie.Fleet.Shadow.Nats.Request do
  @moduledoc """
  Reads a message on `fleet.{environment}.{vehicle}.shadow.{action}`: which action, on which vehicle, by whom. Pure.

  Reading needs no signature: every user of NATS sees the buckets anyway. A change is made in the name of the key that signed
  the message, as for commands (`Aerie.Control.Policy.Signature`); such an update has the version that it is based on, so that a replayed
  copy changes nothing.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Roles, Sources}

  @max_bytes Aerie.Fleet.Shadow.Document.max_bytes()
  @actions %{"get" => :get, "update" => :update, "delete" => :delete, "delta" => :delta}

  @typedoc "`source` is nil for an action that only reads."
  @type t :: %{
          action: :get | :update | :delete | :delta,
          vehicle: String.t(),
          object: map(),
          source: Roles.source() | nil
        }

  @doc "Reads a message at `now` (unix microseconds), or returns the rule and the reason of its refusal."
  @spec read(Aerie.Fleet.Nats.message(), Policy.t() | nil, now :: integer()) ::
          {:ok, t()} | {:refused, rule :: String.t(), reason :: String.t()}
  def read(%{topic: topic, body: body} = message, policy, now) do
    ["fleet", _environment, vehicle, "shadow", word] = String.split(topic, ".")

    with {:ok, action} <- action(word),
         {:ok, object} <- decode(body),
         signature = Map.new(message[:headers] || [])["aerie-signature"],
         {:ok, source} <- identify(action, policy, signature, topic, body, now),
         :ok <- once(action, signature, object) do
      {:ok, %{action: action, vehicle: vehicle, object: object, source: source}}
    end
  end

  defp action(word) do
    with :error <- Map.fetch(@actions, word),
         do: {:refused, "malformed", "the last word of the subject must be get, update, delete or delta"}
  end

  defp decode(body) when byte_size(body) > @max_bytes,
    do: {:refused, "size", "the body has more than #{@max_bytes} bytes"}

  defp decode(""), do: {:ok, %{}}

  defp decode(body) do
    case JSON.decode(body) do
      {:ok, %{} = object} -> {:ok, object}
      _other -> {:refused, "malformed", "the body is not a JSON object"}
    end
  end

  defp identify(action, _policy, _signature, _topic, _body, _now) when action in [:get, :delta],
    do: {:ok, nil}

  defp identify(_action, nil, _signature, _topic, _body, _now),
    do: {:refused, "policy", "the gateway has no policy, so nobody may change anything"}

  defp identify(_action, policy, signature, topic, body, now) do
    with {:error, reason} <- Sources.identify(policy, signature, topic, body, now),
         do: {:refused, "signature", reason}
  end

  defp once(action, signature, object) when action in [:update, :delete] and signature != nil do
    if object["version"] == nil,
      do:
        {:refused, "malformed",
         "version: a signed change names the version that it is meant for, as get gives it"},
      else: :ok
  end

  defp once(_action, _signature, _object), do: :ok
end
