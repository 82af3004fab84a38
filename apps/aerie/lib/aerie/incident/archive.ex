defmodule Aerie.Incident.Archive do
  @moduledoc """
  Writes an archive: a folder beside it for what it is made of, then one `.tar.gz` for its owner only, which never replaces a file.

  Times, owners and modes in it are always the same, so the same files give the same bytes.
  """

  alias Aerie.Base.Files.Private

  @doc "Runs `fun` with a private folder beside `output`, which is removed afterwards."
  @spec with_folder(Path.t(), (Path.t() -> result)) :: result | {:error, String.t()} when result: term()
  def with_folder(output, fun) do
    work = "#{output}.#{System.pid()}.part"

    with :ok <- free(output), :ok <- named(Private.folder(work), work) do
      try do
        fun.(work)
      after
        File.rm_rf(work)
      end
    end
  end

  defp free(output) do
    cond do
      match?({:ok, _stat}, File.lstat(output)) ->
        {:error, "#{output} exists already; --output names another file"}

      not File.dir?(Path.dirname(output)) ->
        {:error, "#{Path.dirname(output)} is not a folder; --output names another file"}

      true ->
        :ok
    end
  end

  @doc "Writes the files of the folder, in this order, below the folder `name` of the archive. `at`: their time. Returns its size."
  @spec write(Path.t(), Path.t(), String.t(), [String.t()], at :: integer()) ::
          {:ok, non_neg_integer()} | {:error, String.t()}
  def write(output, work, name, files, at) do
    new = Path.join(work, "archive")

    with :ok <- named(packed(new, work, name, files, div(at, 1_000_000)), output),
         :ok <- named(File.chmod(new, 0o600), output),
         :ok <- named(moved(new, output), output),
         {:ok, %{size: size}} <- File.stat(output),
         do: {:ok, size}
  end

  defp packed(new, work, name, files, at) do
    with {:ok, device} <- :file.open(new, [:write, :exclusive, :raw, :binary, :compressed]) do
      packed = with {:ok, tar} <- :erl_tar.init(device, :write, &io/2), do: add(tar, work, name, files, at)
      closed = :file.close(device)
      with :ok <- packed, do: closed
    end
  end

  defp add(tar, work, name, files, at) do
    options = [{:mtime, at}, {:atime, at}, {:ctime, at}, {:uid, 0}, {:gid, 0}, {:chunks, 1_048_576}]

    result =
      Enum.reduce_while(files, :ok, fn file, :ok ->
        path = Path.join(work, file)
        _ = File.chmod(path, 0o600)

        case :erl_tar.add(tar, String.to_charlist(path), String.to_charlist("#{name}/#{file}"), options) do
          :ok -> {:cont, :ok}
          error -> {:halt, error}
        end
      end)

    closed = :erl_tar.close(tar)
    with :ok <- result, do: closed
  end

  defp io(:write, {device, data}), do: :file.write(device, data)
  defp io(:position, {device, position}), do: :file.position(device, position)
  defp io(:read2, {device, size}), do: :file.read(device, size)
  # It is closed by its owner.
  defp io(:close, _device), do: :ok

  # A link fails if somebody has made the file meanwhile. Some file systems have none.
  defp moved(new, output) do
    case File.ln(new, output) do
      :ok -> :ok
      {:error, :eexist} -> {:error, :eexist}
      {:error, _no_links} -> if File.exists?(output), do: {:error, :eexist}, else: File.rename(new, output)
    end
  end

  defp named({:error, {_name, reason}}, path), do: named({:error, reason}, path)

  defp named({:error, reason}, path) when is_atom(reason),
    do: {:error, "#{path}: #{:file.format_error(reason)}"}

  defp named({:error, reason}, path), do: {:error, "#{path}: #{:erl_tar.format_error(reason)}"}
  defp named(:ok, _path), do: :ok
end
