defmodule Phoenix.LiveView.Token do
  @moduledoc """
  Values that go to the browser and come back unchanged: signed (HMAC-SHA-256) and timestamped, but not encrypted.

  Each purpose has its own key, so that a token for one purpose is invalid for another.
  """

  @type purpose :: String.t()

  @doc "Signs a term for a purpose. `now` is in seconds."
  @spec sign(binary(), purpose(), term(), integer()) :: String.t()
  def sign(secret, purpose, term, now \\ System.system_time(:second)) do
    payload = :erlang.term_to_binary({now, term})

    Base.url_encode64(payload, padding: false) <>
      "." <> Base.url_encode64(mac(secret, purpose, payload), padding: false)
  end

  @doc "The term of a genuine token that is at most `max_age` seconds old; otherwise `:expired` or `:invalid`."
  @spec verify(binary(), purpose(), term(), non_neg_integer(), integer()) ::
          {:ok, term()} | {:error, :invalid | :expired}
  def verify(secret, purpose, token, max_age, now \\ System.system_time(:second))

  def verify(secret, purpose, token, max_age, now) when is_binary(token) and byte_size(token) <= 16_384 do
    with [payload, mac] <- String.split(token, "."),
         {:ok, payload} <- Base.url_decode64(payload, padding: false),
         {:ok, mac} <- Base.url_decode64(mac, padding: false),
         expected = mac(secret, purpose, payload),
         true <- byte_size(mac) == byte_size(expected) and :crypto.hash_equals(mac, expected),
         # The token is ours, so the term is trusted; `:safe` prevents new atoms if the code has changed since.
         {:ok, {signed, term}} <- decode(payload) do
      if now - signed <= max_age, do: {:ok, term}, else: {:error, :expired}
    else
      _not_ours -> {:error, :invalid}
    end
  end

  def verify(_secret, _purpose, _token, _max_age, _now), do: {:error, :invalid}

  defp decode(payload) do
    {:ok, :erlang.binary_to_term(payload, [:safe])}
  rescue
    ArgumentError -> :error
  end

  defp mac(secret, purpose, payload) do
    key = :crypto.mac(:hmac, :sha256, secret, ["phoenix live view: ", purpose])
    :crypto.mac(:hmac, :sha256, key, payload)
  end
end
