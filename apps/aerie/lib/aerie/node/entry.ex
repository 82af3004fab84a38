defmodule Aerie.Node.Entry do
  @moduledoc """
  The files of running gateways in the folder of `Aerie.Node.Settings`: one for each, named after its node, and the cookie. They
  give access to these gateways, so only their owner can read them.
  """

  alias Aerie.Base.Files.Private

  @typedoc """
    * `name` - of the node, before the `@`; `port` - where its distribution listens, on loopback
    * `pid` - of the operating system; `started` - ISO 8601
    * `http`, `config` - address of the console and the configuration file, for people who have several gateways
  """
  @type t :: %{
          name: String.t(),
          port: :inet.port_number(),
          pid: pos_integer(),
          started: String.t(),
          http: String.t() | nil,
          config: String.t() | nil
        }

  @max_bytes 4096
  # The name becomes an atom, as Erlang has it for nodes.
  @max_name 64

  @doc "Writes the file of a gateway."
  @spec write(Path.t(), t()) :: :ok | {:error, File.posix()}
  def write(dir, entry), do: Private.write(file(dir, entry.name), JSON.encode!(entry))

  @doc "Removes it."
  @spec remove(Path.t(), name :: String.t()) :: :ok
  def remove(dir, name) do
    _ = File.rm(file(dir, name))
    :ok
  end

  @doc "The gateways that run, in the order of their start. What one left that was killed is removed."
  @spec list(Path.t()) :: {:ok, [t()]} | {:error, File.posix()}
  def list(dir) do
    with {:ok, names} <- File.ls(dir) do
      {running, gone} =
        for(
          file <- names,
          Path.extname(file) == ".gateway",
          {:ok, entry} <- [read(Path.join(dir, file))],
          do: entry
        )
        |> Enum.split_with(&runs?(&1.pid))

      Enum.each(gone, &remove(dir, &1.name))
      {:ok, Enum.sort_by(running, & &1.started)}
    end
  end

  # A program that can write there can command the gateway anyway; a damaged file is ignored.
  defp read(path) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, text} <- File.read(path),
         {:ok, %{"name" => "aerie-" <> _ = name, "port" => port, "pid" => pid, "started" => started} = entry}
         when byte_size(name) <= @max_name and port in 1..65_535 and is_integer(pid) and is_binary(started) <-
           JSON.decode(text),
         true <- Path.basename(path) == name <> ".gateway" do
      {:ok,
       %{name: name, port: port, pid: pid, started: started, http: entry["http"], config: entry["config"]}}
    else
      _no_entry -> :error
    end
  end

  # The pid may have been reused; then connecting fails with an error.
  defp runs?(pid), do: File.exists?("/proc/#{pid}") or not File.exists?("/proc/self")

  @doc "The cookie of a folder; made when there is none."
  @spec cookie(Path.t()) :: {:ok, atom()} | {:error, File.posix()}
  def cookie(dir) do
    path = Path.join(dir, "cookie")

    with :ok <- Private.folder(dir),
         {:error, :enoent} <- read_cookie(path),
         :ok <- Private.write(path, Base.url_encode64(:crypto.strong_rand_bytes(24))) do
      # If two start at once, the last write wins.
      read_cookie(path)
    end
  end

  @doc "The cookie of a folder, as `bin/aerie` needs it."
  @spec read_cookie(Path.t()) :: {:ok, atom()} | {:error, File.posix()}
  def read_cookie(path) do
    case File.read(path) do
      {:ok, text} when byte_size(text) in 16..255 -> {:ok, String.to_atom(text)}
      {:ok, _short} -> {:error, :enoent}
      error -> error
    end
  end

  defp file(dir, name), do: Path.join(dir, name <> ".gateway")
end
