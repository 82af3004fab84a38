defmodule Aerie.Config.Preflight.Contents do
  @moduledoc """
  Checks that a configured file holds what its key is for, so that a wrong path to a readable file is found at the start, not
  when the first connection fails. Errors never quote the file's content.
  """

  # Keys and certificates have a few KiB; a system's list of authorities has a few hundred.
  @max_bytes 8_388_608

  @typedoc "What a file must hold."
  @type kind :: :credentials | :nkey_seed | :certificates | :private_key

  @doc "`:ok`, or what was expected and what was found."
  @spec check(kind(), Path.t()) :: :ok | {:error, expected :: String.t(), got :: String.t()}
  def check(kind, file) do
    with {:ok, %File.Stat{size: size}} when size <= @max_bytes <- File.stat(file),
         {:ok, text} <- File.read(file),
         :ok <- content(kind, text) do
      :ok
    else
      {:ok, %File.Stat{size: size}} -> {:error, expected(kind), "#{file}: #{size} bytes are too many"}
      {:error, reason} when is_atom(reason) -> {:error, expected(kind), "#{file}: #{posix(reason)}"}
      {:error, why} -> {:error, expected(kind), "#{file}: #{why}"}
    end
  end

  defp expected(:credentials), do: "a credentials file of NATS (a user's JWT and an nkey seed)"
  defp expected(:nkey_seed), do: "a file with the nkey seed of a user (SU…)"
  defp expected(:certificates), do: "a PEM file with certificates"
  defp expected(:private_key), do: "a PEM file with a private key"

  defp content(:credentials, text), do: with({:ok, _parts} <- Nkey.Credentials.parse(text), do: :ok)

  defp content(:nkey_seed, text) do
    case Nkey.from_seed(text) do
      {:ok, %{purpose: :user}} -> :ok
      {:ok, %{purpose: purpose}} -> {:error, "it is the seed of an nkey for #{purpose}, not for a user"}
      error -> error
    end
  end

  defp content(:certificates, text), do: pem(text, &(elem(&1, 0) == :Certificate), "no certificate in it")

  # An encrypted key would need a password that nobody can configure.
  defp content(:private_key, text) do
    key? = fn {type, _der, cipher} ->
      cipher == :not_encrypted and type in [:PrivateKeyInfo, :RSAPrivateKey, :ECPrivateKey, :DSAPrivateKey]
    end

    pem(text, key?, "no private key without a password in it")
  end

  defp pem(text, wanted?, otherwise) do
    entries = :public_key.pem_decode(text)

    cond do
      entries == [] -> {:error, "it is not PEM"}
      not Enum.any?(entries, wanted?) -> {:error, otherwise}
      Enum.all?(entries, &readable?/1) -> :ok
      true -> {:error, "what is in it cannot be decoded"}
    end
  rescue
    # The text between the lines of dashes is not Base64.
    _error -> {:error, "it is not PEM"}
  end

  defp readable?({:Certificate, der, :not_encrypted}) do
    _certificate = :public_key.pkix_decode_cert(der, :plain)
    true
  rescue
    _error -> false
  end

  defp readable?(entry) do
    _key = :public_key.pem_entry_decode(entry)
    true
  rescue
    _error -> false
  end

  defp posix(reason), do: reason |> :file.format_error() |> to_string()
end
