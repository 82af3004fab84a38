defmodule Aerie.Upgrade.Tarball do
  @moduledoc "Unpacks a release's tarball beside the installed versions, and calls the `install.sh` in it."

  alias Aerie.Upgrade.Versions

  @max_bytes 1_000_000_000

  @doc """
  Installs what is in `file`, which has a gateway that runs hand over to it; `words` are for that `aerie upgrade`. The
  exit status and what to print.
  """
  @spec install(Path.t(), Versions.t(), [String.t()]) :: {0..255, iodata()} | {:error, String.t()}
  def install(file, versions, words) do
    with :ok <- readable(file),
         :ok <- sum(file),
         {:ok, top} <- top(file),
         {:ok, folder} <- unpack(file, versions.folder) do
      script = Path.join([folder, top, "install.sh"])
      {_output, status} = System.cmd(script, ["--upgrade" | words], into: IO.stream())
      _ = File.rm_rf(folder)
      {status, ""}
    end
  end

  defp readable(file) do
    case File.stat(file) do
      {:ok, %File.Stat{type: :regular, size: size}} when size <= @max_bytes -> :ok
      {:ok, _other} -> {:error, "#{file}: expected a release's tarball"}
      {:error, posix} -> {:error, "#{file}: #{:file.format_error(posix)}"}
    end
  end

  # `bin/release` writes it beside the tarball.
  defp sum(file) do
    case File.read(file <> ".sha256") do
      {:ok, text} ->
        found =
          file
          |> File.stream!(1_048_576)
          |> Enum.reduce(:crypto.hash_init(:sha256), &:crypto.hash_update(&2, &1))

        if String.starts_with?(text, Base.encode16(:crypto.hash_final(found), case: :lower)),
          do: :ok,
          else: {:error, "#{file} is not what #{file}.sha256 says: copy it again"}

      {:error, _none} ->
        IO.puts("(#{file}.sha256 is not there to compare)")
    end
  end

  defp top(file) do
    machine = :system_architecture |> :erlang.system_info() |> to_string() |> String.split("-") |> hd()

    with {text, 0} <- System.cmd("tar", ["-tzf", file], stderr_to_stdout: true),
         names = String.split(text, "\n", trim: true),
         [top] <- names |> Enum.map(&hd(Path.split(&1))) |> Enum.uniq(),
         true <-
           Enum.all?(names, &(".." not in Path.split(&1))) and
             Enum.any?(names, &(&1 == Path.join(top, "install.sh"))) do
      if String.ends_with?(top, "-" <> machine),
        do: {:ok, top},
        else: {:error, "#{file} has #{top}; this machine is #{machine}"}
    else
      _other -> {:error, "#{file} is not a release's tarball, or was cut off"}
    end
  end

  defp unpack(file, beside) do
    folder = Path.join(beside, ".unpacked-#{System.pid()}")

    with :ok <- File.mkdir(folder),
         {_none, 0} <-
           System.cmd("tar", ["-xzf", file, "-C", folder, "--no-same-owner"], stderr_to_stdout: true) do
      {:ok, folder}
    else
      {:error, :eacces} ->
        {:error, "only a user who may write #{beside} can upgrade the gateway: sudo aerie upgrade"}

      {:error, posix} ->
        {:error, "#{folder}: #{:file.format_error(posix)}"}

      {text, _status} ->
        _ = File.rm_rf(folder)
        {:error, "#{file} cannot be unpacked: #{String.trim(text)}"}
    end
  end
end
