defmodule Aerie.Control.Policy.Roles.Signature do
  @moduledoc """
  Signed commands: an Ed25519 signature by a NATS key (nkey) over the command as it was sent.

  The header `Aerie-Signature` of a NATS message or an HTTP request has three words: the public nkey (`U…`), the time of
  signing (ISO 8601 with an offset), and the signature in base64url without padding.

      Aerie-Signature: UDXU4RCS… 2026-11-22T09:30:00Z 5mZ8…

  These bytes are signed, `\\n` being a line feed; nothing is encoded again, so there is nothing to agree on but this:

      aerie-command-1\\nSUBJECT\\nTIME\\nBODY

  `SUBJECT` is `fleet.{environment}.{vehicle}.cmd.{type}`, over REST too, so that a command for one vehicle is not valid
  for another; `TIME` is the text of the header, and `BODY` the bytes of the message.

  A signature counts for a minute. Within that a message that is sent again has the same id, and gets the stored result.
  """

  alias Aerie.Vehicle.Command.Refusal

  @old_us 60_000_000
  @ahead_us 5_000_000
  @max_header 512

  @doc "The header for a command."
  @spec sign(Nkey.t(), subject :: String.t(), body :: binary(), DateTime.t()) :: String.t()
  def sign(nkey, subject, body, time) do
    at = DateTime.to_iso8601(time)
    signature = nkey |> Nkey.sign(bytes(subject, at, body)) |> Base.url_encode64(padding: false)
    "#{nkey.public} #{at} #{signature}"
  end

  @doc """
  The public nkey by which a command was signed rightly and lately. Whether that key may command anything is another
  question. `now` is in unix microseconds.
  """
  @spec verify(header :: String.t(), subject :: String.t(), body :: binary(), now :: integer()) ::
          {:ok, public :: String.t()} | Refusal.denial()
  def verify(header, subject, body, now) do
    with {:ok, {key, public, at, signature}} <- read(header, now) do
      if Nkey.verify(public, bytes(subject, at, body), signature),
        do: {:ok, key},
        else: Refusal.deny(:signature)
    end
  end

  @doc """
  The public nkey that a header names, if it is well-formed and its time counts: what can be known without the work of
  checking the signature.
  """
  @spec claim(header :: String.t(), now :: integer()) :: {:ok, public :: String.t()} | Refusal.denial()
  def claim(header, now) do
    with {:ok, {key, _public, _at, _signature}} <- read(header, now), do: {:ok, key}
  end

  defp read(header, now) when byte_size(header) <= @max_header do
    with [key, at, signature] <- String.split(header),
         {:ok, <<_::512>> = signature} <- Base.url_decode64(signature, padding: false),
         {:ok, time, _offset} <- DateTime.from_iso8601(at),
         :ok <- fresh(DateTime.to_unix(time, :microsecond), now),
         {:ok, :user, public} <- Nkey.from_public(key) do
      {:ok, {key, public, at, signature}}
    else
      {:deny, :signature, _reason} = denial -> denial
      _malformed -> Refusal.deny(:signature_malformed)
    end
  end

  defp read(_long, _now), do: Refusal.deny(:signature_long, most: @max_header)

  defp fresh(at, now) do
    cond do
      now - at > @old_us ->
        Refusal.deny(:signature_old, seconds: div(now - at, 1_000_000), most: div(@old_us, 1_000_000))

      at - now > @ahead_us ->
        Refusal.deny(:signature_ahead, seconds: div(at - now, 1_000_000))

      true ->
        :ok
    end
  end

  defp bytes(subject, at, body),
    do: ["aerie-command-1", subject, at, body] |> Enum.intersperse("\n") |> IO.iodata_to_binary()
end
