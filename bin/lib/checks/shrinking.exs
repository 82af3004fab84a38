# Limits with exceptions that may only shrink. exceptions/NAME.txt has a line for each: the number that stands today,
# and what has it.
#
# A limit is a map: `:name`, `:most`, `:found` (numbers by what has them; those within the limit may be left out), and
# `:problem`, a function that makes the message from what has it, its number and the number allowed.
defmodule Shrinking do
  @folder Path.join(__DIR__, "exceptions")

  @doc "What is over its limit or its exception, and exceptions that are higher than they need to be."
  def problems(limit, allowed \\ nil) do
    allowed = allowed || read(limit.name)

    over =
      for {what, n} <- Enum.sort(limit.found),
          most = Map.get(allowed, what, limit.most),
          n > most,
          do: limit.problem.(what, n, most)

    spare =
      for {what, n} <- Enum.sort(allowed),
          now = Map.get(limit.found, what, 0),
          now < n or now <= limit.most do
        todo = if now > limit.most, do: "lower it to #{now}", else: "remove it"

        "bin/lib/checks/exceptions/#{limit.name}.txt: #{n} for #{what}, which has #{now}; #{todo} (bin/layers --shrink)"
      end

    over ++ spare
  end

  @doc "Lowers the exceptions to what is found, and never raises one."
  def shrink(limit) do
    kept = shrunk(limit, read(limit.name))
    File.write!(file(limit.name), for({what, n} <- Enum.sort(kept), do: "#{n} #{what}\n"))
  end

  def shrunk(limit, allowed) do
    for {what, n} <- allowed,
        now = min(n, Map.get(limit.found, what, 0)),
        now > limit.most,
        into: %{},
        do: {what, now}
  end

  defp read(name) do
    for line <- name |> file() |> File.read!() |> String.split("\n", trim: true), into: %{} do
      {n, " " <> what} = Integer.parse(line)
      {what, n}
    end
  end

  defp file(name), do: Path.join(@folder, "#{name}.txt")
end
