defmodule MavCodec.Generated.Dialects.Part1 do
  use MavCodec.Definition.Shard, dialects: {1, 4}
end
