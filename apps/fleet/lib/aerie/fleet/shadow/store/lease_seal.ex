defmodule Aerie.Fleet.Shadow.Store.LeaseSeal do
  @moduledoc """
  Seals leases and signs of life: a gateway believes only those that a gateway with the same key wrote, so
  access to NATS alone takes no vehicle from anybody.

  The seal is the header `Aerie-Seal`, a number and an HMAC-SHA-256 over environment, key of the bucket, value
  and number. It stands beside the value, which earlier versions go on reading. A lease has the key of its
  vehicle, a sign of life that of its gateway: the common one, or aboard (`shadow.vehicle_key`) the vehicle's,
  whose id then ends the gateway's name. The number grows with each word
  (`Aerie.Fleet.Shadow.GatewayLease.Numbers`), so an old one counts for nothing.
  """

  alias Aerie.Base.Secret
  alias Aerie.Fleet.Shadow.Keys

  @header "Aerie-Seal"
  @context "aerie-lease-1"
  # No name of a vehicle has a star.
  @gateways "*"

  @typedoc "What is sealed: a gateway's sign of life, or a vehicle's lease."
  @type subject :: {:gateway | :vehicle, String.t()}

  @doc "The header's name."
  @spec header() :: String.t()
  def header, do: @header

  @doc "The name of a gateway, by which others find its key: a companion's ends with the vehicle whose key it has."
  @spec name(instance :: String.t(), Keys.t()) :: String.t()
  def name(instance, %Keys{own: own}), do: Enum.join([instance | Map.keys(own)], "-")

  @doc "The header of a value, \"\" for its removal."
  @spec headers(Keys.t(), environment :: String.t(), subject(), value :: binary(), pos_integer()) ::
          [{String.t(), String.t()}]
  def headers(keys, environment, subject, value, number),
    do: [{@header, "#{number} #{mac(keys, environment, subject, value, number)}"}]

  @doc "The number of a sealed value. The seal is nil if it has none."
  @spec read(Keys.t(), environment :: String.t(), subject(), value :: binary(), seal :: String.t() | nil) ::
          {:ok, pos_integer()} | :unsealed | :forged
  def read(_keys, _environment, _subject, _value, nil), do: :unsealed

  def read(keys, environment, subject, value, seal) do
    with [digits, given] when byte_size(digits) <= 16 <- String.split(seal, " "),
         {number, ""} when number > 0 <- Integer.parse(digits),
         mac = mac(keys, environment, subject, value, number),
         true <- byte_size(mac) == byte_size(given) and :crypto.hash_equals(mac, given) do
      {:ok, number}
    else
      _other -> :forged
    end
  end

  defp mac(keys, environment, {kind, name} = subject, value, number) do
    text = JSON.encode!([@context, environment, Atom.to_string(kind), name, Base.encode64(value), number])
    key = Keys.of(keys, environment, whose(subject))
    :hmac |> :crypto.mac(:sha256, Secret.reveal(key), text) |> Base.encode16(case: :lower)
  end

  defp whose({:vehicle, vehicle}), do: vehicle

  defp whose({:gateway, name}) do
    case String.split(name, "-", parts: 2) do
      [_instance, vehicle] -> vehicle
      [_instance] -> @gateways
    end
  end
end
