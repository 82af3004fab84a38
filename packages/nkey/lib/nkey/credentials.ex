defmodule Nkey.Credentials do
  @moduledoc """
  A NATS credentials file (`.creds`): a user's JWT and the seed of its key between lines of dashes.

      -----BEGIN NATS USER JWT-----
      eyJ0eXAi...
      ------END NATS USER JWT------

      -----BEGIN USER NKEY SEED-----
      SUAM...
      ------END USER NKEY SEED------
  """

  # A JWT with hundreds of permissions has some tens of KiB; a larger file is something else.
  @max_bytes 1_048_576

  @type t :: %{jwt: String.t(), nkey_seed: String.t()}

  @doc "Reads a file into the settings `:jwt` and `:nkey_seed` of a connection."
  @spec read(Path.t()) :: {:ok, t()} | {:error, String.t()}
  def read(path) do
    with {:ok, %File.Stat{size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, text} <- File.read(path),
         {:ok, credentials} <- parse(text) do
      {:ok, credentials}
    else
      {:ok, %File.Stat{size: size}} -> error(path, "#{size} bytes are too many for a credentials file")
      {:error, why} when is_binary(why) -> error(path, why)
      {:error, posix} -> error(path, to_string(:file.format_error(posix)))
    end
  end

  @doc "The same from the text of a file."
  @spec parse(String.t()) :: {:ok, t()} | {:error, String.t()}
  def parse(text) do
    with {:ok, jwt} <- block(text, "NATS USER JWT"),
         {:ok, seed} <- block(text, "USER NKEY SEED"),
         {:ok, _nkey} <- Nkey.from_seed(seed) do
      {:ok, %{jwt: jwt, nkey_seed: seed}}
    end
  end

  defp block(text, name) do
    case Regex.run(~r/-{3,} *BEGIN #{name} *-{3,}\s+([A-Za-z0-9_.=-]+?)\s+-{3,} *END #{name} *-{3,}/, text) do
      [_all, content] -> {:ok, content}
      nil -> {:error, "no #{name} block"}
    end
  end

  defp error(path, why), do: {:error, "#{path}: #{why}"}
end
