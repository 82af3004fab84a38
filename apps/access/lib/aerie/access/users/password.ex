defmodule Aerie.Access.Users.Password do
  @moduledoc """
  Passwords as PBKDF2-HMAC-SHA-256, each with its own salt: `pbkdf2-sha256$ITERATIONS$SALT$HASH`, salt and hash in Base64. Hashing takes
  tenths of a second on purpose.
  """

  @iterations 600_000
  @fewest 1_000
  @most 10_000_000
  @shortest 10
  @longest 200

  @typedoc "The stored form."
  @type stored :: String.t()

  @doc "The smallest number of characters of a password."
  @spec shortest() :: pos_integer()
  def shortest, do: @shortest

  @doc "Checks whether a new password is acceptable."
  @spec check(term()) :: :ok | {:error, String.t()}
  def check(password) when is_binary(password) do
    cond do
      not String.valid?(password) -> {:error, "the password is not valid UTF-8"}
      String.length(password) < @shortest -> {:error, "a password has #{@shortest} characters or more"}
      byte_size(password) > @longest -> {:error, "a password has #{@longest} bytes at most"}
      true -> :ok
    end
  end

  def check(_other), do: {:error, "the password is missing"}

  @doc "Hashes a password."
  @spec hash(String.t(), pos_integer()) :: stored()
  def hash(password, iterations \\ @iterations) do
    salt = :crypto.strong_rand_bytes(16)
    hash = derive(password, salt, iterations)
    Enum.join(["pbkdf2-sha256", iterations, Base.encode64(salt), Base.encode64(hash)], "$")
  end

  @doc "Whether a password matches the stored one. Without a stored one (nil) it takes as long, and does not match."
  @spec match?(term(), stored() | nil) :: boolean()
  def match?(password, stored) when is_binary(password) and byte_size(password) <= @longest do
    case parse(stored) do
      {:ok, iterations, salt, hash} ->
        :crypto.hash_equals(derive(password, salt, iterations), hash)

      :error ->
        _as_long = derive(password, <<0::128>>, @iterations)
        false
    end
  end

  def match?(_password, _stored), do: false

  @doc "Whether this is the stored form of a password."
  @spec stored?(term()) :: boolean()
  def stored?(text), do: parse(text) != :error

  defp parse("pbkdf2-sha256$" <> rest) do
    with [iterations, salt, hash] <- String.split(rest, "$"),
         {iterations, ""} when iterations in @fewest..@most <- Integer.parse(iterations),
         {:ok, <<_::128>> = salt} <- Base.decode64(salt),
         {:ok, <<_::256>> = hash} <- Base.decode64(hash) do
      {:ok, iterations, salt, hash}
    else
      _other -> :error
    end
  end

  defp parse(_other), do: :error

  defp derive(password, salt, iterations), do: :crypto.pbkdf2_hmac(:sha256, password, salt, iterations, 32)
end
