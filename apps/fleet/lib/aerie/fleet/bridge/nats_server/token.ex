defmodule Aerie.Fleet.Bridge.NatsServer.Token do
  @moduledoc """
  The login of the embedded server: a random token. It is made at the first start and kept in the file `token` beside the
  server's data, so that programs can still log in after a restart. The file `url` has the address with the token. Only
  their owner can read both. `nats.token` replaces the random token.
  """

  alias Aerie.Base.Secret
  alias Aerie.Base.Files.Private

  @doc "The token; it is made if there is none yet."
  @spec fetch(map()) :: {:ok, String.t()} | {:error, String.t()}
  def fetch(nats) do
    with {:error, _reason} <- read(nats), do: make(file(nats))
  end

  @doc "The token of a server that was started before."
  @spec read(map()) :: {:ok, String.t()} | {:error, String.t()}
  def read(%{token: token}) when token != nil, do: {:ok, Secret.reveal(token)}

  def read(nats) do
    with {:ok, text} <- File.read(file(nats)),
         token = String.trim(text),
         true <- token =~ ~r/\A[0-9a-f]{32,}\z/ do
      {:ok, token}
    else
      {:error, reason} -> {:error, "cannot read #{file(nats)}: #{:file.format_error(reason)}"}
      false -> {:error, "#{file(nats)} has no token"}
    end
  end

  defp make(file) do
    token = 16 |> :crypto.strong_rand_bytes() |> Base.encode16(case: :lower)
    with :ok <- write(file, token), do: {:ok, token}
  end

  @doc "Writes the address with the token into a file for its owner."
  @spec put_url(map(), String.t(), String.t()) :: :ok | {:error, String.t()}
  def put_url(nats, url, token), do: write(url_file(nats), with_token(url, token))

  @doc "The address with the token that `put_url/3` wrote, or nil."
  @spec url(map()) :: String.t() | nil
  def url(nats) do
    case File.read(url_file(nats)) do
      {:ok, text} -> String.trim(text)
      {:error, _reason} -> nil
    end
  end

  @doc "The file that `put_url/3` writes."
  @spec url_file(map()) :: Path.t()
  def url_file(nats), do: Path.join(nats.store_dir, "url")

  defp with_token(url, token) do
    uri = URI.parse(url)
    URI.to_string(%{uri | authority: nil, userinfo: URI.encode(token, &URI.char_unreserved?/1)})
  end

  defp file(nats), do: Path.join(nats.store_dir, "token")

  defp write(file, text) do
    with {:error, reason} <- Private.write(file, text <> "\n"),
         do: {:error, "cannot write #{file}: #{:file.format_error(reason)}"}
  end
end
