defmodule Aerie.Shadow.SealedDocument do
  @moduledoc """
  Protects desired documents in a bucket that others may write to: a gateway accepts only what a gateway with the same key wrote.
  So access to NATS alone does not allow anybody to command a vehicle by its desired state.

  The seal is an HMAC-SHA-256 over environment, vehicle and content, so that the document of one vehicle is not valid for another.
  """

  alias Aerie.Secret
  alias Aerie.Shadow.Document

  @context "aerie-shadow-1"

  @doc "The document as JSON with its seal."
  @spec encode(Document.t(), environment :: String.t(), Secret.t()) :: String.t()
  def encode(document, environment, key) do
    plain = Document.plain(document)
    JSON.encode!(Map.put(plain, "seal", mac(plain, environment, key)))
  end

  @doc "Reads a document that `encode/3` wrote for this vehicle."
  @spec decode(binary(), environment :: String.t(), vehicle :: String.t(), Secret.t()) ::
          {:ok, Document.t()} | {:error, String.t()}
  def decode(text, environment, vehicle, key) do
    with {:ok, %{"seal" => seal} = object} when is_binary(seal) <- JSON.decode(text),
         plain = Map.delete(object, "seal"),
         true <- equal?(mac(plain, environment, key), seal) do
      Document.parse(plain, vehicle)
    else
      false ->
        {:error,
         "its seal does not fit: it was written by something else than a gateway with this shadow.key"}

      _other ->
        {:error, "it has no seal: it was not written by a gateway"}
    end
  end

  defp equal?(a, b), do: byte_size(a) == byte_size(b) and :crypto.hash_equals(a, b)

  defp mac(plain, environment, key) do
    text = JSON.encode!([@context, environment, sorted(plain)])
    :hmac |> :crypto.mac(:sha256, Secret.reveal(key), text) |> Base.encode16(case: :lower)
  end

  # The order of an object's keys is not defined.
  defp sorted(map) when is_map(map), do: for({key, value} <- Enum.sort(map), do: [key, sorted(value)])
  defp sorted(list) when is_list(list), do: Enum.map(list, &sorted/1)
  defp sorted(value), do: value
end
