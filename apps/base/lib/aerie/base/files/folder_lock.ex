defmodule Aerie.Base.Files.FolderLock do
  @moduledoc """
  Gives a folder of data one owner, because two gateways that write into one store or outbox would destroy it.

  Within this VM, the calling process owns the folder through `Aerie.Base.Names.Book` until it ends. Between VMs, a file `owner`
  holds the owner's process id and, where `/proc` has it, its start time: a killed owner leaves the file behind, and
  another process may have got its pid since.
  """

  alias Aerie.Base.Names.Book
  alias Aerie.Base.Files.Private

  @doc """
  Makes the calling process the owner. An error says who has the folder, or why it cannot be written.
  """
  @spec acquire(Path.t()) :: :ok | {:error, String.t()}
  def acquire(dir) do
    dir = Path.expand(dir)

    with :ok <- make(dir), :ok <- register(dir), :ok <- unowned(dir) do
      write(dir)
    end
  end

  defp make(dir) do
    case Private.folder(dir) do
      :ok -> :ok
      {:error, reason} -> {:error, "cannot make folder #{dir}: #{:file.format_error(reason)}"}
    end
  end

  defp register(dir) do
    case Book.register({__MODULE__, dir}, nil) do
      :ok ->
        :ok

      {:error, {:already_registered, pid}} when pid == self() ->
        :ok

      {:error, {:already_registered, _pid}} ->
        {:error, "folder #{dir} is in use by another gateway in this program"}
    end
  end

  defp unowned(dir) do
    with {:ok, text} <- File.read(owner_file(dir)),
         [pid, started] <- text |> String.trim() |> String.split(" ", parts: 2),
         true <- pid != System.pid() and started != "" and started == start_time(pid) do
      Book.unregister({__MODULE__, dir})
      {:error, "folder #{dir} is in use by another gateway (process #{pid})"}
    else
      # No file, an unreadable one, an owner that is gone, or ourselves.
      _ -> :ok
    end
  end

  defp write(dir) do
    case Private.write(owner_file(dir), "#{System.pid()} #{start_time(System.pid())}\n") do
      :ok -> :ok
      {:error, reason} -> {:error, "cannot write into folder #{dir}: #{:file.format_error(reason)}"}
    end
  end

  defp owner_file(dir), do: Path.join(dir, "owner")

  @doc "The start time of an OS process as an opaque text; `\"\"` without such a process or without `/proc`."
  @spec start_time(String.t()) :: String.t()
  def start_time(pid) do
    # The second field is the program's name in brackets and may hold anything; the 20th after it is the start time.
    with true <- pid =~ ~r/\A\d+\z/,
         {:ok, stat} <- File.read("/proc/#{pid}/stat"),
         [_, rest] <- Regex.run(~r/\A.*\) (.*)\z/s, stat),
         fields = String.split(rest),
         # A zombie owns nothing.
         false <- hd(fields) in ["Z", "X"],
         started when is_binary(started) <- Enum.at(fields, 19) do
      started
    else
      _ -> ""
    end
  end
end
