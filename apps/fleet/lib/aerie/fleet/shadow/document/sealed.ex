defmodule Aerie.Fleet.Shadow.Document.Sealed do
  @moduledoc """
  Protects desired documents in a bucket that others may write to: a gateway accepts only what a gateway with the same key wrote.
  So access to NATS alone does not allow anybody to command a vehicle by its desired state.

  The seal is an HMAC-SHA-256 over environment, vehicle and content by the vehicle's key (`Aerie.Fleet.Shadow.Keys`), so that neither the document
  nor the key of one vehicle is valid for another. Earlier versions sealed all vehicles' documents with the common key; these are still
  read, and a reader seals it again.
  """

  alias Aerie.Base.Secret
  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Keys

  @context "aerie-shadow-2"
  @former "aerie-shadow-1"

  @doc "The document as JSON with its seal."
  @spec encode(Document.t(), environment :: String.t(), Keys.t()) :: String.t()
  def encode(document, environment, keys) do
    plain = Document.plain(document)
    key = Keys.of(keys, environment, document.vehicle)
    JSON.encode!(Map.put(plain, "seal", mac(plain, @context, environment, key)))
  end

  @doc "Reads a document that `encode/3` wrote for this vehicle; `:former` if an earlier version sealed it: seal it again."
  @spec decode(binary(), environment :: String.t(), vehicle :: String.t(), Keys.t()) ::
          {:ok, Document.t()} | {:former, Document.t()} | {:error, String.t()}
  def decode(text, environment, vehicle, keys) do
    with {:ok, %{"seal" => seal} = object} when is_binary(seal) <- JSON.decode(text),
         plain = Map.delete(object, "seal"),
         {:sealed, kind} <- kind(plain, seal, environment, vehicle, keys),
         {:ok, document} <- Document.parse(plain, vehicle) do
      {kind, document}
    else
      :forged ->
        {:error,
         "its seal does not fit: it was written by something else than a gateway with this vehicle's key (shadow.key, shadow.vehicle_key)"}

      {:error, why} when is_binary(why) ->
        {:error, why}

      _other ->
        {:error, "it has no seal: it was not written by a gateway"}
    end
  end

  defp kind(plain, seal, environment, vehicle, keys) do
    cond do
      equal?(mac(plain, @context, environment, Keys.of(keys, environment, vehicle)), seal) -> {:sealed, :ok}
      Enum.any?(Keys.former(keys), &equal?(mac(plain, @former, environment, &1), seal)) -> {:sealed, :former}
      true -> :forged
    end
  end

  defp equal?(a, b), do: byte_size(a) == byte_size(b) and :crypto.hash_equals(a, b)

  defp mac(plain, context, environment, key) do
    text = JSON.encode!([context, environment, sorted(plain)])
    :hmac |> :crypto.mac(:sha256, Secret.reveal(key), text) |> Base.encode16(case: :lower)
  end

  # The order of an object's keys is not defined.
  defp sorted(map) when is_map(map), do: for({key, value} <- Enum.sort(map), do: [key, sorted(value)])
  defp sorted(list) when is_list(list), do: Enum.map(list, &sorted/1)
  defp sorted(value), do: value
end
