defmodule Nkey do
  @moduledoc """
  NATS keys: Ed25519 keys in base 32, with a letter for their purpose in front and a CRC-16 behind.

  Errors are texts for a person, which never show the key. A seed (`SU...`, `SA...`, `SO...`) is the secret half; the public half begins with the second letter alone (`U...`).
  """

  import Bitwise

  @prefix_seed 18 <<< 3
  @purposes %{operator: 14 <<< 3, server: 13 <<< 3, cluster: 2 <<< 3, account: 0, user: 20 <<< 3}
  @purpose_of Map.new(@purposes, fn {purpose, prefix} -> {prefix, purpose} end)

  @derive {Inspect, only: [:purpose, :public]}
  @enforce_keys [:purpose, :public, :secret]
  defstruct @enforce_keys

  @typedoc "`public` is the key as text, `secret` the 32 secret bytes (never inspected)."
  @type t :: %__MODULE__{purpose: purpose(), public: String.t(), secret: <<_::256>>}
  @type purpose :: :operator | :server | :cluster | :account | :user

  @doc "A new random key."
  @spec generate(purpose()) :: t()
  def generate(purpose), do: build(purpose, :crypto.strong_rand_bytes(32))

  @doc "The key of a seed. Blanks around the text do not matter."
  @spec from_seed(String.t()) :: {:ok, t()} | {:error, String.t()}
  def from_seed(seed) when is_binary(seed) do
    with {:ok, bytes} <- unbase32(String.trim(seed)),
         {:ok, content} <- check_crc(bytes),
         {:ok, purpose, secret} <- open(content) do
      {:ok, build(purpose, secret)}
    else
      {:error, why} -> {:error, "not an nkey seed: #{why}"}
    end
  end

  def from_seed(_other), do: {:error, "an nkey seed is a text beginning with S"}

  @doc "The seed as text. Secret."
  @spec seed(t()) :: String.t()
  def seed(%__MODULE__{purpose: purpose, secret: secret}) do
    prefix = @purposes[purpose]
    base32(<<@prefix_seed ||| prefix >>> 5, (prefix &&& 31) <<< 3, secret::binary>>)
  end

  @doc "The Ed25519 signature of some bytes, 64 bytes."
  @spec sign(t(), binary()) :: binary()
  def sign(%__MODULE__{secret: secret}, bytes), do: :crypto.sign(:eddsa, :none, bytes, [secret, :ed25519])

  @doc "The purpose and the 32 public bytes of a public key (`U...`)."
  @spec from_public(String.t()) :: {:ok, purpose(), <<_::256>>} | {:error, String.t()}
  def from_public(text) when is_binary(text) do
    with {:ok, bytes} <- unbase32(String.trim(text)),
         {:ok, <<prefix, public::binary-size(32)>>} <- check_crc(bytes),
         purpose when purpose != nil <- @purpose_of[prefix] do
      {:ok, purpose, public}
    else
      {:error, why} -> {:error, "not a public nkey: #{why}"}
      _other -> {:error, "not a public nkey: it is of another kind"}
    end
  end

  def from_public(_other), do: {:error, "a public nkey is a text such as U..."}

  @doc "Whether a signature of some bytes was made with the secret half of a public key."
  @spec verify(public :: <<_::256>>, bytes :: binary(), signature :: binary()) :: boolean()
  def verify(public, bytes, signature) when byte_size(signature) == 64,
    do: :crypto.verify(:eddsa, :none, bytes, signature, [public, :ed25519])

  def verify(_public, _bytes, _other), do: false

  defp build(purpose, secret) do
    {public, _secret} = :crypto.generate_key(:eddsa, :ed25519, secret)
    %__MODULE__{purpose: purpose, public: base32(<<@purposes[purpose], public::binary>>), secret: secret}
  end

  defp open(<<first, second, secret::binary-size(32)>>) when (first &&& 0xF8) == @prefix_seed do
    case @purpose_of[(first &&& 7) <<< 5 ||| second >>> 3] do
      nil -> {:error, "of a purpose that is not known"}
      purpose -> {:ok, purpose, secret}
    end
  end

  defp open(<<first, _::binary>>) when (first &&& 0xF8) != @prefix_seed,
    do: {:error, "it does not begin with S"}

  defp open(_other), do: {:error, "it has not the right length"}

  defp check_crc(bytes) when byte_size(bytes) > 2 do
    size = byte_size(bytes) - 2
    <<content::binary-size(^size), crc::little-16>> = bytes
    if crc16(content) == crc, do: {:ok, content}, else: {:error, "its checksum is wrong"}
  end

  defp check_crc(_short), do: {:error, "it has not the right length"}

  defp unbase32(text) do
    case Base.decode32(text, padding: false) do
      {:ok, bytes} -> {:ok, bytes}
      :error -> {:error, "it is not base 32"}
    end
  end

  defp base32(content), do: Base.encode32(<<content::binary, crc16(content)::little-16>>, padding: false)

  # CRC-16/XMODEM
  defp crc16(bytes), do: crc16(bytes, 0)

  defp crc16(<<byte, rest::binary>>, crc), do: crc16(rest, shift(bxor(crc, byte <<< 8), 8))
  defp crc16("", crc), do: crc

  defp shift(crc, 0), do: crc
  defp shift(crc, bits) when (crc &&& 0x8000) != 0, do: shift(bxor(crc <<< 1, 0x1021) &&& 0xFFFF, bits - 1)
  defp shift(crc, bits), do: shift(crc <<< 1, bits - 1)
end
