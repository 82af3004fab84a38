defmodule Aerie.Base.Net.UnixSocket do
  @moduledoc """
  A listening unix socket as a file with its permissions.

  It is bound inside a folder that only we can enter, given its mode, and then renamed to its place: at no moment can
  somebody connect whom the mode would keep out. A socket left behind by a gateway that was killed is replaced; one that
  answers belongs to somebody, and a file that is not a socket is never touched.
  """

  @mode 0o660
  # sun_path of Linux, without its final NUL.
  @longest 107

  @typedoc "What tells our socket from another one that came to stand in its place. A file system gives an inode again at once."
  @type identity :: {device :: integer(), inode :: integer(), made :: integer()}

  @doc """
  Where the sockets are when nobody says: `$XDG_RUNTIME_DIR/aerie`, else `/run/aerie` where that can be written (root, or
  a service whose unit makes it), else `var/run` beside the gateway's other files. `writable?` answers for a folder.
  """
  @spec default_dir(%{optional(String.t()) => String.t()}, (Path.t() -> boolean())) :: Path.t()
  def default_dir(env, writable? \\ &writable?/1) do
    case env do
      %{"XDG_RUNTIME_DIR" => "/" <> _ = dir} -> Path.join(dir, "aerie")
      _other -> if writable?.("/run/aerie") or writable?.("/run"), do: "/run/aerie", else: "var/run"
    end
  end

  @doc "The folder of the sockets: the configured one, or `default_dir/2`."
  @spec dir(Path.t() | nil) :: Path.t()
  def dir(configured), do: Path.expand(configured || default_dir(System.get_env()))

  defp writable?(dir), do: match?({:ok, %File.Stat{access: :read_write}}, File.stat(dir))

  @doc """
  Listens at a path, whose folder is made (for its owner only) when it is not there. The error is words for a person.
  """
  @spec listen(Path.t()) :: {:ok, :gen_tcp.socket(), identity()} | {:error, String.t()}
  def listen(path) do
    dir = Path.dirname(path)
    hidden = Path.join(dir, ".#{System.unique_integer([:positive])}-#{System.pid()}")

    with :ok <- short(Path.join(hidden, "s")),
         :ok <- folder(dir),
         :ok <- vacant(path),
         :ok <- with_path(File.mkdir(hidden), hidden),
         :ok <- with_path(File.chmod(hidden, 0o700), hidden) do
      result = bind(Path.join(hidden, "s"), path)
      _ = File.rm(Path.join(hidden, "s"))
      _ = File.rmdir(hidden)
      result
    end
  end

  @doc "Removes the socket's file, if it still is the one that `listen/1` made."
  @spec remove(Path.t(), identity()) :: :ok
  def remove(path, identity) do
    _ = if identity(path) == {:ok, identity}, do: File.rm(path)
    :ok
  end

  @doc "Whether the file at the path still is the one that `listen/1` made."
  @spec present?(Path.t(), identity()) :: boolean()
  def present?(path, identity), do: identity(path) == {:ok, identity}

  defp bind(from, to) do
    options = [:binary, ifaddr: {:local, from}, active: false, backlog: 1024]

    with {:ok, socket} <- listening(options, to) do
      with :ok <- with_path(File.chmod(from, @mode), to),
           {:ok, identity} <- identity(from),
           :ok <- with_path(File.rename(from, to), to) do
        {:ok, socket, identity}
      else
        {:error, reason} ->
          :gen_tcp.close(socket)
          {:error, reason}
      end
    end
  end

  defp listening(options, path) do
    case :gen_tcp.listen(0, options) do
      {:ok, socket} -> {:ok, socket}
      {:error, reason} -> {:error, "#{path}: #{:inet.format_error(reason)}"}
    end
  end

  defp short(path) when byte_size(path) <= @longest, do: :ok

  defp short(path),
    do:
      {:error,
       "#{Path.dirname(Path.dirname(path))}: the name is too long for a socket's folder, at most #{@longest - 24} bytes"}

  defp folder(dir) do
    if File.dir?(dir) do
      :ok
    else
      with :ok <- with_path(File.mkdir_p(dir), dir), do: with_path(File.chmod(dir, 0o700), dir)
    end
  end

  defp vacant(path) do
    case File.lstat(path) do
      {:error, :enoent} -> :ok
      {:ok, %File.Stat{type: :other}} -> stale(path)
      {:ok, _file} -> {:error, "#{path} is there and is not a socket"}
      {:error, reason} -> with_path({:error, reason}, path)
    end
  end

  defp stale(path) do
    case :gen_tcp.connect({:local, path}, 0, [:binary, active: false], 1000) do
      {:ok, socket} ->
        :gen_tcp.close(socket)
        {:error, "#{path} is served by another program"}

      # Nobody listens: it is left over, and the rename will replace it.
      {:error, reason} when reason in [:econnrefused, :enoent] ->
        :ok

      {:error, reason} ->
        {:error, "#{path}: #{:inet.format_error(reason)}"}
    end
  end

  defp identity(path) do
    case File.lstat(path, time: :posix) do
      {:ok, %File.Stat{type: :other, major_device: device, inode: inode, mtime: made}} ->
        {:ok, {device, inode, made}}

      {:ok, _file} ->
        {:error, "#{path} is not a socket"}

      {:error, reason} ->
        with_path({:error, reason}, path)
    end
  end

  defp with_path(:ok, _path), do: :ok
  defp with_path({:error, reason}, path), do: {:error, "#{path}: #{:file.format_error(reason)}"}
end
