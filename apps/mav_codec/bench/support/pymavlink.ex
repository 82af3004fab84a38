defmodule MavCodec.Bench.Pymavlink do
  @moduledoc "pymavlink on the same bytes, when there is a Python that has it: `$AERIE_VENV`, or `.venv` at the top of the checkout."

  @script Path.expand("pymavlink_parse.py", __DIR__)
  @venv Path.expand("../../../../.venv", __DIR__)

  @doc "The Python to use, or `nil`."
  def python do
    [System.get_env("AERIE_VENV"), @venv]
    |> Enum.reject(&(&1 in [nil, ""]))
    |> Enum.map(&Path.join([&1, "bin", "python"]))
    |> Enum.find(&match?({_, 0}, run(&1, ["-c", "import pymavlink"])))
  end

  @doc "Frames found, {best, median, 99th percentile} of ns per frame, and the bytes of the frames found."
  def parse(python, data, rounds) do
    folder = Path.join(System.tmp_dir!(), "aerie-bench-#{System.pid()}-#{System.unique_integer([:positive])}")
    File.mkdir_p!(folder)
    file = Path.join(folder, "stream.bin")
    found = Path.join(folder, "found.bin")

    try do
      File.write!(file, data)
      command = ~s(exec "$0" "$1" "$2" "$3" 2>"$4")
      {out, 0} = System.cmd("sh", ["-c", command, python, @script, file, to_string(rounds), found])
      [frames | times] = String.split(out)
      {String.to_integer(frames), times |> Enum.map(&String.to_float/1) |> List.to_tuple(), File.read!(found)}
    after
      File.rm_rf!(folder)
    end
  end

  defp run(python, arguments) do
    if File.exists?(python), do: System.cmd(python, arguments, stderr_to_stdout: true), else: {"", 1}
  end
end
