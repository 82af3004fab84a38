defmodule Aerie.System.DamagedStartTest do
  @moduledoc "A gateway starts whatever a power cut, a full disk or a hand made of the files that it keeps."

  use Aerie.SystemCase, async: true

  @moduletag :tmp_dir
  @moduletag :capture_log

  # Of parts that write nothing in a gateway that does nothing.
  @others ~w(console/users.json console/keys console/sessions.json signing/timestamps.json signing/keys/main-7
             outbox/position.json params/main-7.json shadow/desired/VID-007 shadow/plans/x recordings/index)

  for damage <- [:empty, :half, :garbage, :folder] do
    test "all of its files: #{damage}", %{tmp_dir: folder} do
      stop_gateway(start(folder))
      for file <- @others, do: plant(Path.join(folder, file))

      files =
        for path <- Path.wildcard(Path.join(folder, "**"), match_dot: true),
            File.regular?(path),
            not String.starts_with?(path, Path.join(folder, "nats/data")),
            # With a folder in the place of these a gateway starts, and goes without NATS and outbox.
            unquote(damage) != :folder or not (path =~ "/nats/" or Path.basename(path) == "owner"),
            do: path

      assert Enum.count(files, &(Path.basename(&1) == "FORMAT")) == 3
      Enum.each(files, &damage(&1, unquote(damage)))
      %{gateway: gateway} = start(folder)

      named = for %{path: path} <- Aerie.Base.Files.Damaged.list(gateway), do: Path.relative_to(path, folder)
      assert ["outbox/FORMAT", "shadow/FORMAT"] -- named == []

      eventually(
        fn -> Enum.any?(Aerie.Fleet.Diagnosis.list(gateway), &(&1.name == :files_damaged)) end,
        "a diagnosis"
      )

      for dir <- ~w(outbox shadow tracks),
          do:
            eventually(
              fn -> File.read(Path.join([folder, dir, "FORMAT"])) == {:ok, "aerie-#{dir} 1\n"} end,
              dir
            )
    end
  end

  defp start(folder),
    do: start_gateway(folder, overrides: %{"signing" => %{"dir" => Path.join(folder, "signing")}})

  defp plant(path) do
    File.mkdir_p!(Path.dirname(path))
    File.write!(path, ~s({"version": 1}))
    File.chmod!(path, 0o600)
  end

  defp damage(path, :empty), do: File.write!(path, "")

  defp damage(path, :half),
    do: File.write!(path, binary_part(File.read!(path), 0, div(File.stat!(path).size, 2)))

  defp damage(path, :garbage), do: File.write!(path, <<0xFF, 0, 0xFE, 7>> <> :binary.copy("\0zz", 100))

  defp damage(path, :folder) do
    File.rm!(path)
    File.mkdir!(path)
  end
end
