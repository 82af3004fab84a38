defmodule Aerie.Control.Params.Metadata.Unpack do
  @moduledoc """
  Metadata that is compressed (T5): `.xz` by the program `xz`, which comes with a release, because OTP has no such decompression. What it may become is bounded, in size,
  memory and time.
  """

  @max_bytes 16_777_216
  # PX4 packs with the largest preset (-9), which takes 65 MiB to unpack.
  @memory "--memlimit-decompress=80MiB"
  @ms 20_000

  @doc "The content of a file, by its name."
  @spec file(Path.t(), binary()) :: {:ok, binary()} | {:error, String.t()}
  def file(path, bytes) do
    if String.ends_with?(path, ".xz"), do: xz(bytes), else: {:ok, bytes}
  end

  defp xz(bytes) do
    case System.find_executable("xz") do
      nil ->
        {:error,
         "the vehicle's metadata is compressed, and there is no xz on the PATH: install the package xz-utils"}

      program ->
        unpacked(program, bytes)
    end
  end

  # Ports cannot close the input of a program alone, so it reads a file.
  defp unpacked(program, bytes) do
    path = Path.join(System.tmp_dir!(), "aerie-#{Base.encode16(:crypto.strong_rand_bytes(8))}.xz")

    try do
      with :ok <- File.write(path, bytes, [:exclusive]) do
        options = [:binary, :exit_status, :hide, args: ["--decompress", "--stdout", "-qq", @memory, path]]

        collect(
          Port.open({:spawn_executable, program}, options),
          [],
          0,
          System.monotonic_time(:millisecond) + @ms
        )
      else
        {:error, reason} ->
          {:error, "the compressed metadata cannot be written: #{:file.format_error(reason)}"}
      end
    after
      File.rm(path)
    end
  end

  defp collect(port, read, size, until) do
    receive do
      {^port, {:data, bytes}} when size + byte_size(bytes) > @max_bytes ->
        close(port, "the metadata has more than #{@max_bytes} bytes")

      {^port, {:data, bytes}} ->
        collect(port, [read, bytes], size + byte_size(bytes), until)

      {^port, {:exit_status, 0}} ->
        {:ok, IO.iodata_to_binary(read)}

      {^port, {:exit_status, _status}} ->
        {:error, "the vehicle's compressed metadata is damaged"}
    after
      max(until - System.monotonic_time(:millisecond), 0) ->
        close(port, "the metadata could not be decompressed in #{@ms} ms")
    end
  end

  defp close(port, reason) do
    Port.close(port)
    flush(port)
    {:error, reason}
  end

  defp flush(port) do
    receive do
      {^port, _late} -> flush(port)
    after
      0 -> :ok
    end
  end
end
